// CUDA's part of device code, and the only file with PTX. This file comes first in every device
// source. generic.cuh follows and describes the functions.
#define VENDOR_FN static __device__ __forceinline__
#define VENDOR_ENTRY extern "C" __global__ void
#define VENDOR_HAS_GRID_CONSTANT

#define VENDOR_WARP 32
VENDOR_FN void vendor_warp_barrier(const unsigned threads = ~0u) { __syncwarp(threads); }
VENDOR_FN unsigned vendor_shuffle_up(unsigned word, int lanes) {
  return __shfl_up_sync(0xffffffffu, word, lanes);
}

#define VENDOR_HAS_SEEDS
VENDOR_FN float vendor_rcp_seed(float a) {
  float r;
  asm("rcp.approx.ftz.f32 %0, %1;" : "=f"(r) : "f"(a));
  return r;
}
VENDOR_FN float vendor_rsqrt_seed(float a) {
  float r;
  asm("rsqrt.approx.ftz.f32 %0, %1;" : "=f"(r) : "f"(a));
  return r;
}

#define VENDOR_HAS_PREFETCH
VENDOR_FN void vendor_prefetch(const void* p) {
  asm volatile("prefetch.global.L2 [%0];" ::"l"(p));
}

#ifdef NOVAPHY_PERSISTENT
#define VENDOR_HAS_PLACES
VENDOR_FN void vendor_is_loaded(int& word) { asm volatile("" : "+r"(word)); }
template <class T>
VENDOR_FN T* vendor_global(T* p) {
  __builtin_assume(__isGlobal(p));
  return p;
}
template <class T>
VENDOR_FN T* vendor_stays_shared(T* p) {
  unsigned address = (unsigned)__cvta_generic_to_shared(p);
  asm volatile("" : "+r"(address));
  return (T*)__cvta_shared_to_generic(address);
}

#define VENDOR_HAS_BLOCK_BARRIERS
VENDOR_FN void vendor_block_barrier() { asm volatile("barrier.sync 0;" ::: "memory"); }
template <int threads>
VENDOR_FN void vendor_hand_over() {
  asm volatile("barrier.arrive 1, %0;" ::"n"(threads) : "memory");
}
template <int threads>
VENDOR_FN void vendor_take_over() {
  asm volatile("barrier.sync 1, %0;" ::"n"(threads) : "memory");
}

#define VENDOR_HAS_GRID_BARRIER
VENDOR_FN void vendor_grid_barrier(unsigned* counter, unsigned all) {
  unsigned seen;
  asm volatile("red.release.gpu.global.add.u32 [%0], 1;" ::"l"(counter) : "memory");
  do {
    asm volatile("ld.acquire.gpu.global.u32 %0, [%1];" : "=r"(seen) : "l"(counter) : "memory");
  } while (seen < all);
}

// Barriers of clusters have no generic version. Only texts for vendors with clusters use them.
VENDOR_FN void vendor_cluster_arrive(bool wrote) {
  if (wrote) {
    asm volatile("barrier.cluster.arrive.release;" ::: "memory");
  } else {
    __threadfence_block();  // orders the writes to a record, which only this block reads
    asm volatile("barrier.cluster.arrive.relaxed;" ::: "memory");
  }
}
VENDOR_FN void vendor_cluster_wait() {
  asm volatile("barrier.cluster.wait.acquire;" ::: "memory");
}
VENDOR_FN void vendor_prefetch_bytes(unsigned long long p, unsigned bytes) {
  asm volatile("cp.async.bulk.prefetch.L2.global [%0], %1;" ::"l"(p), "r"(bytes));
}
VENDOR_FN int vendor_of_lane(int word, unsigned lane) {
  return __shfl_sync(0xffffffffu, word, lane);
}
// Returns an address in the shared memory of this block, or the same address in another block of
// the cluster.
VENDOR_FN unsigned vendor_in_shared(const void* p) {
  return (unsigned)__cvta_generic_to_shared(p);
}
VENDOR_FN unsigned vendor_in_block(unsigned address, unsigned block) {
  unsigned there;
  asm("mapa.shared::cluster.u32 %0, %1, %2;" : "=r"(there) : "r"(address), "r"(block));
  return there;
}
// Initializes the two barriers at an address. A barrier counts received bytes.
VENDOR_FN void vendor_begin_bytes(unsigned barriers) {
  asm volatile(
      "mbarrier.init.shared::cta.b64 [%0], 1;\n"
      "mbarrier.init.shared::cta.b64 [%0 + 8], 1;\n"
      "fence.mbarrier_init.release.cluster;" ::"r"(barriers)
      : "memory");
}
VENDOR_FN void vendor_expect_bytes(unsigned barrier, unsigned bytes) {
  asm volatile("mbarrier.arrive.expect_tx.shared::cta.b64 _, [%0], %1;" ::"r"(barrier), "r"(bytes)
               : "memory");
}
VENDOR_FN void vendor_wait_bytes(unsigned barrier, unsigned parity) {
  unsigned came;
  do {
    asm volatile(
        "{\n"
        ".reg .pred p;\n"
        "mbarrier.try_wait.parity.acquire.cluster.shared::cta.b64 p, [%1], %2;\n"
        "selp.u32 %0, 1, 0, p;\n"
        "}"
        : "=r"(came)
        : "r"(barrier), "r"(parity)
        : "memory");
  } while (came == 0);
}
// Sends four words to another block, whose barrier counts their bytes. Sends nothing if `on` is 0.
VENDOR_FN void vendor_send_words(unsigned to, unsigned barrier, unsigned on, const int* words) {
  asm volatile(
      "{\n"
      ".reg .pred p;\n"
      "setp.ne.u32 p, %0, 0;\n"
      "@p st.async.shared::cluster.mbarrier::complete_tx::bytes.v4.b32 [%1], {%2, %3, %4, %5}, [%6];\n"
      "}" ::"r"(on),
      "r"(to), "r"(words[0]), "r"(words[1]), "r"(words[2]), "r"(words[3]), "r"(barrier)
      : "memory");
}
#endif
