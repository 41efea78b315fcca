// Hand-written kernels, as a function of one row. A header that declares kernels is read twice.
// Here each kernel becomes a function over rows that the CPU backend runs. The compilers of devices
// read the header as source; core/device/ has the twin of this header for them.
//
//   struct ScaleArguments {
//     NOVAPHY_ARGUMENTS(ReadsRow<float> x; WritesRow<float> y; Number<float> factor;)
//   };
//   NOVAPHY_ROW_KERNEL(scale, ScaleArguments) { a.y[row] = a.factor.value * a.x[row]; }
//
// declares the kernel `scale`. In the body `a` are the arguments (launch_arguments.h), `row` is the
// row and `n` the number of rows. Rows run in any order and at the same time, so a row may not read
// what another one writes.
//
// Such headers are called *_kernels.h and include formulas, the math headers, the enumerations and
// this one, nothing else. novaphy_add_device_module (cmake/NovaPhyDeviceModule.cmake) makes the
// text that devices get; Kernel launches a kernel. Names of kernels are unique in a text, whatever
// the namespaces.
#pragma once

#include <cstdint>

#include "novaphy/abi/backend.h"
#include "novaphy/core/launch_arguments.h"

namespace novaphy {
// A kernel of this struct of arguments.
template <class A>
struct RowKernel : novaphy_row_function {
  using Arguments = A;
};

// The same kernel, of which a thread of the CPU takes so many rows at a time: where a row is much
// work.
template <class A>
constexpr RowKernel<A> in_chunks(RowKernel<A> kernel, uint32_t rows) {
  kernel.chunk = rows;
  return kernel;
}
// Launches refer to kernels.
template <const auto& kernel, uint32_t rows>
inline constexpr auto kInChunks = in_chunks(kernel, rows);
}  // namespace novaphy

// Kernels for devices only, as a function of a block of 128 threads, which may share memory and
// wait for each other. The body follows within #ifdef NOVAPHY_KERNEL, as
//
//   NOVAPHY_BLOCK_KERNEL(team, ScaleArguments);
//   NOVAPHY_BLOCK_BODY(team, ScaleArguments) { ... }
//
// where `a` are the arguments, `block` is the block and `blocks` the number of blocks. A launch
// over n rows has a block for every 128 of them. A CPU is refused (ErrorKind::NotImplemented).
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
