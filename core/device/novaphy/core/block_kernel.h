// Replaces <novaphy/core/block_kernel.h> in device code. The threads of a block share its loops.
#pragma once

#include "novaphy/core/row_kernel.h"

namespace novaphy {

constexpr int64_t kBlockRows = 128;

template <class Body>
inline void for_block(const int64_t begin, const int64_t end, const Body& body) {
  for (int64_t k = begin + (int64_t)threadIdx.x; k < end; k += kBlockRows) body(k);
}
inline void wait_for_block() { __syncthreads(); }
inline bool is_first_of_block() { return threadIdx.x == 0; }

}  // namespace novaphy

#define NOVAPHY_SHARED_BLOCK_KERNEL(NAME, ARGUMENTS)                                 \
  static_assert(sizeof(ARGUMENTS) % 8 == 0);                                         \
  inline void NAME##_block(const ARGUMENTS& a, const int64_t block);                 \
  NOVAPHY_KERNEL NAME(const ARGUMENTS arguments, const int64_t, const device_sink) { \
    NAME##_block(arguments, (int64_t)blockIdx.x);                                    \
  }                                                                                  \
  inline void NAME##_block(const ARGUMENTS& a, const int64_t block)
