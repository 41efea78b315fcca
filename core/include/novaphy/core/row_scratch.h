// Scratch memory of one row of a hand-written kernel, for data that exceeds the registers of a
// device thread. On the CPU the memory is an object on the stack. On a device (core/device/) the
// memory is a row of an array, whose initial values are those of the previous launch.
#pragma once

#include <cstddef>
#include <vector>

#include "novaphy/core/row_stack.h"

#define NOVAPHY_ROW_SCRATCH(TYPE, NAME, MEMORY) TYPE NAME

namespace novaphy {
inline constexpr int64_t kRowStack = kHostRowStack;

// Returns memory for `count` doubles that belongs to the calling thread. The memory is valid until
// the next call of the thread. The version for devices returns null.
inline double* thread_numbers(int64_t count) {
  static thread_local std::vector<double> numbers;
  if (numbers.size() < static_cast<size_t>(count)) numbers.resize(static_cast<size_t>(count));
  return numbers.data();
}
}  // namespace novaphy
