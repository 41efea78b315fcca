// What the file of a vendor leaves out, in plain CUDA C++, with the same bits. A vendor defines
// VENDOR_HAS_... and the functions of that group where its devices have something of their own.
#ifndef VENDOR_FN
#define VENDOR_FN static __device__ __forceinline__
#endif
// How kernels begin. C linkage is for those that are looked up by name.
#ifndef VENDOR_ENTRY
#define VENDOR_ENTRY __global__ void
#endif
// Around the text of a module, whose functions are for devices without saying so.
#ifndef VENDOR_SOURCE_BEGIN
#define VENDOR_SOURCE_BEGIN
#define VENDOR_SOURCE_END
#endif
// Shared memory whose size the launch says.
#ifndef VENDOR_SHARED
#define VENDOR_SHARED(type, name) extern __shared__ type name[]
#endif
// Kernels read their arguments where the launch put them; else the compiler may copy them.
#ifndef VENDOR_HAS_GRID_CONSTANT
#undef __grid_constant__
#define __grid_constant__
#endif

// The threads that run together and may exchange words: vendor_warp_barrier, vendor_shuffle_up. 1:
// nothing is known, and threads meet at the barriers of their block alone.
#ifndef VENDOR_WARP
#define VENDOR_WARP 1
#endif

// About 1 / a and 1 / sqrt(a), from which a quotient and a root are made that are rounded correctly.
#ifndef VENDOR_HAS_SEEDS
VENDOR_FN float vendor_rcp_seed(float a) { return 1.0f / a; }
VENDOR_FN float vendor_rsqrt_seed(float a) { return 1.0f / __fsqrt_rn(a); }
#endif

// Memory that will be read.
#ifndef VENDOR_HAS_PREFETCH
VENDOR_FN void vendor_prefetch(const void*) {}
#endif

#ifdef NOVAPHY_PERSISTENT
// A word that is loaded here, not behind the next branch; a pointer into global memory; one into
// shared memory that stays in a register.
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

// Where all threads of a block come, in any warp; and a second barrier, at which some threads leave
// a message and go on, and others wait for them.
#ifndef VENDOR_HAS_BLOCK_BARRIERS
VENDOR_FN void vendor_block_barrier() { __syncthreads(); }
#endif

// One thread of each block comes here, for all blocks to wait for each other. All of them run.
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
