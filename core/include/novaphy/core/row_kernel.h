// Hand-written kernels, as a function of one row. A header that declares some is read twice: here,
// where each becomes a function over rows that the CPU backend runs, and as text that the compilers
// of devices read (there core/device/ has the twin of this header).
//
//   struct Scale { const float* x; float* y; FloatWord factor; };  // members of 8 bytes
//   NOVAPHY_ROW_KERNEL(scale, 3, Scale) { a.y[row] = a.factor.value * a.x[row]; }
//
// declares the kernel `scale` with 3 argument words. In the body `a` are the arguments, `row` is
// the row and `n` the number of rows. Rows run in any order and at the same time, so a row may not
// read what another one writes.
//
// Such headers are called *_kernels.h and include formulas, the math headers, the enumerations and
// this one, nothing else. novaphy_add_device_module (cmake/NovaPhyDeviceModule.cmake) makes the
// text that devices get; DeviceKernel launches a kernel. Names of kernels are unique in a text,
// whatever the namespaces.
#pragma once

#include <cstdint>

#include "novaphy/abi/backend.h"

namespace novaphy {
// An argument word that holds a float.
struct FloatWord {
  float value;
  uint32_t unused;
};
}  // namespace novaphy

// Kernels for devices only, as a function of a block of 128 threads, which may share memory and
// wait for each other. The body follows within #ifdef NOVAPHY_KERNEL, as
//
//   NOVAPHY_BLOCK_KERNEL(team, 3, Scale);
//   NOVAPHY_BLOCK_BODY(team, Scale) { ... }
//
// where `a` are the arguments, `block` is the block and `blocks` the number of blocks. A launch
// over n rows has a block for every 128 of them. A CPU is refused (ErrorKind::NotImplemented).
#define NOVAPHY_BLOCK_KERNEL(NAME, WORDS, ARGUMENTS)                                           \
  static_assert(sizeof(ARGUMENTS) == 8 * (WORDS), #NAME ": every argument has 8 bytes");       \
  inline constexpr novaphy_row_function NAME = {sizeof(novaphy_row_function), #NAME, WORDS, 0, \
                                                nullptr}

#define NOVAPHY_ROW_KERNEL(NAME, WORDS, ARGUMENTS)                                                \
  static_assert(sizeof(ARGUMENTS) == 8 * (WORDS), #NAME ": every argument has 8 bytes");          \
  inline void NAME##_row(const ARGUMENTS& a, int64_t row, int64_t n);                             \
  inline void NAME##_rows(const uint64_t* words, int64_t n, int64_t begin, int64_t end) {         \
    ARGUMENTS a;                                                                                  \
    __builtin_memcpy(&a, words, sizeof(a));                                                       \
    for (int64_t row = begin; row < end; ++row) NAME##_row(a, row, n);                            \
  }                                                                                               \
  inline constexpr novaphy_row_function NAME = {sizeof(novaphy_row_function), #NAME, WORDS, 0,    \
                                                NAME##_rows};                                     \
  inline void NAME##_row([[maybe_unused]] const ARGUMENTS& a, [[maybe_unused]] const int64_t row, \
                         [[maybe_unused]] const int64_t n)
