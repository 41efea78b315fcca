// Hand-written kernels as functions of one row. A header with kernels is compiled twice. The C++
// compiler makes each kernel a function over rows that the CPU backend runs. Device compilers read
// the header as source, with the version of this header in core/device/.
//
//   struct ScaleArguments {
//     NOVAPHY_ARGUMENTS(ReadsRow<float> x; WritesRow<float> y; Number<float> factor;)
//   };
//   NOVAPHY_ROW_KERNEL(scale, ScaleArguments) { a.y[row] = a.factor.value * a.x[row]; }
//
// This declares the kernel `scale`. In the body, `a` holds the arguments (launch_arguments.h),
// `row` is the row and `n` the number of rows. Rows run in any order and at the same time. A row
// may therefore not read what another row writes.
//
// Such headers are named *_kernels.h. Such a header includes only formulas, math headers,
// enumerations and this header. novaphy_add_device_module (cmake/NovaPhyDeviceModule.cmake) makes
// the source for devices, and Kernel launches a kernel. Kernel names are unique in such a source,
// whatever the namespace.
#pragma once

#include <cstdint>

#include "novaphy/abi/backend.h"
#include "novaphy/core/launch_arguments.h"

namespace novaphy {
// A kernel with the argument struct A.
template <class A>
struct RowKernel : novaphy_row_function {
  using Arguments = A;
};

// Returns the same kernel with another chunk size: the number of rows that a CPU thread takes at a
// time. Kernels with much work per row use small chunks.
template <class A>
constexpr RowKernel<A> in_chunks(RowKernel<A> kernel, uint32_t rows) {
  kernel.chunk = rows;
  return kernel;
}
// The kernel with another chunk size as a constant, because launches keep a reference to the
// kernel.
template <const auto& kernel, uint32_t rows>
inline constexpr auto kInChunks = in_chunks(kernel, rows);
}  // namespace novaphy

// Declares a kernel for devices only, as a function of a block of 128 threads. The threads of a
// block may share memory and wait for each other. The body follows within #ifdef NOVAPHY_KERNEL:
//
//   NOVAPHY_BLOCK_KERNEL(team, ScaleArguments);
//   NOVAPHY_BLOCK_BODY(team, ScaleArguments) { ... }
//
// In the body, `a` holds the arguments, `block` is the index of the block and `blocks` the number
// of blocks. A launch over n rows has one block for every 128 rows. A launch on the CPU throws
// ErrorKind::NotImplemented.
#define NOVAPHY_BLOCK_KERNEL(NAME, ARGUMENTS)    \
  inline constexpr RowKernel<ARGUMENTS> NAME = { \
      {sizeof(novaphy_row_function), #NAME, sizeof(ARGUMENTS) / sizeof(uint64_t), 0, nullptr}}

#define NOVAPHY_ROW_KERNEL(NAME, ARGUMENTS)                                                       \
  inline void NAME##_row(const ARGUMENTS& a, int64_t row, int64_t n);                             \
  inline void NAME##_rows(const uint64_t* words, int64_t n, int64_t begin, int64_t end) {         \
    const auto& a = ::novaphy::detail::arguments_of<ARGUMENTS>(words);                            \
    for (int64_t row = begin; row < end; ++row) NAME##_row(a, row, n);                            \
  }                                                                                               \
  inline constexpr ::novaphy::RowKernel<ARGUMENTS> NAME = {{sizeof(novaphy_row_function), #NAME,  \
                                                            sizeof(ARGUMENTS) / sizeof(uint64_t), \
                                                            0, NAME##_rows}};                     \
  inline void NAME##_row([[maybe_unused]] const ARGUMENTS& a, [[maybe_unused]] const int64_t row, \
                         [[maybe_unused]] const int64_t n)
