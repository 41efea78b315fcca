// The defaults of vendor-specific functions, in plain CUDA C++, with the same bits. A vendor's file
// that defines a group of functions itself also defines the group's macro VENDOR_HAS_....
#ifndef VENDOR_FN
#define VENDOR_FN static __device__ __forceinline__
#endif
// The beginning of a kernel's declaration. Kernels that are looked up by name need C linkage.
#ifndef VENDOR_ENTRY
#define VENDOR_ENTRY __global__ void
#endif
// These macros enclose the text of a module, whose functions are device functions without an
// annotation.
#ifndef VENDOR_SOURCE_BEGIN
#define VENDOR_SOURCE_BEGIN
#define VENDOR_SOURCE_END
#endif
// Declares shared memory whose size the launch sets.
#ifndef VENDOR_SHARED
#define VENDOR_SHARED(type, name) extern __shared__ type name[]
#endif
// With __grid_constant__, kernels read their arguments in place. Otherwise the compiler may copy
// them.
#ifndef VENDOR_HAS_GRID_CONSTANT
#undef __grid_constant__
#define __grid_constant__
#endif

// The number of threads of a warp, which run together and may exchange words: vendor_warp_barrier,
// vendor_shuffle_up. 1 means an unknown number. Threads then synchronize only at barriers of their
// block.
#ifndef VENDOR_WARP
#define VENDOR_WARP 1
#endif

// Approximations of 1 / a and 1 / sqrt(a), which are refined to correctly rounded quotients and
// roots.
#ifndef VENDOR_HAS_SEEDS
VENDOR_FN float vendor_rcp_seed(float a) { return 1.0f / a; }
VENDOR_FN float vendor_rsqrt_seed(float a) { return 1.0f / __fsqrt_rn(a); }
#endif

// Prefetches memory that will be read soon.
#ifndef VENDOR_HAS_PREFETCH
VENDOR_FN void vendor_prefetch(const void*) {}
#endif

#ifdef NOVAPHY_PERSISTENT
// vendor_is_loaded forces the load of a word before the next branch. vendor_global converts a
// pointer to global memory. vendor_stays_shared keeps a pointer to shared memory in a register.
#ifndef VENDOR_HAS_PLACES
VENDOR_FN void vendor_is_loaded(int&) {}
template <class T>
VENDOR_FN T* vendor_global(T* p) {
  return p;
}
template <class T>
VENDOR_FN T* vendor_stays_shared(T* p) {
  return p;
}
#endif

// A barrier for all threads of a block, in any warp. A vendor with clusters also has a handover,
// where some threads signal and go on, and others wait for the signal.
#ifndef VENDOR_HAS_BLOCK_BARRIERS
VENDOR_FN void vendor_block_barrier() { __syncthreads(); }
#endif

// A barrier of all blocks, which one thread of each block calls. All blocks must be running.
#ifndef VENDOR_HAS_GRID_BARRIER
VENDOR_FN void vendor_grid_barrier(unsigned* counter, unsigned all) {
  __threadfence();
  atomicAdd(counter, 1u);
  while (*(volatile unsigned*)counter < all) {
  }
  __threadfence();
}
#endif
#endif
