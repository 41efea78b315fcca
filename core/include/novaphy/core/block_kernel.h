// Kernels as functions of a block of threads (row_kernel.h), which the CPU runs too.
//
//   NOVAPHY_SHARED_BLOCK_KERNEL(solve, SolveArguments) { ... }
//
// In the body, `a` holds the arguments and `block` is the number of the block. A launch over n rows
// has one block for every kBlockRows rows. On a device the threads of a block share the loops of
// for_block. On the CPU one thread runs a whole block, so its loops are plain loops.
#pragma once

#include "novaphy/core/row_kernel.h"

namespace novaphy {

constexpr int64_t kBlockRows = 128;

// Calls body(k) for the numbers in [begin, end), which the threads of a block share.
template <class Body>
inline void for_block(int64_t begin, int64_t end, const Body& body) {
  for (int64_t k = begin; k < end; ++k) body(k);
}
// Waits until all threads of the block have come here.
inline void wait_for_block() {}
// Returns whether this thread is the first of its block.
inline bool is_first_of_block() { return true; }

}  // namespace novaphy

#define NOVAPHY_SHARED_BLOCK_KERNEL(NAME, ARGUMENTS)                                              \
  inline void NAME##_block(const ARGUMENTS& a, int64_t block);                                    \
  inline void NAME##_rows(const uint64_t* words, int64_t, int64_t begin, int64_t end) {           \
    const auto& a = ::novaphy::detail::arguments_of<ARGUMENTS>(words);                            \
    for (int64_t row = begin; row < end; ++row)                                                   \
      if (row % ::novaphy::kBlockRows == 0) NAME##_block(a, row / ::novaphy::kBlockRows);         \
  }                                                                                               \
  inline constexpr ::novaphy::RowKernel<ARGUMENTS> NAME = {{sizeof(novaphy_row_function), #NAME,  \
                                                            sizeof(ARGUMENTS) / sizeof(uint64_t), \
                                                            0, NAME##_rows}};                     \
  inline void NAME##_block(const ARGUMENTS& a, const int64_t block)
