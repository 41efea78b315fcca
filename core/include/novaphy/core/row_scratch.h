// Memory of a row of a hand-written kernel that is too large for the registers of a device's
// thread. On the CPU the memory is an object on the stack. On a device (core/device/) it is a row
// of an array, which keeps the values of the last launch.
#pragma once

#include <cstddef>
#include <vector>

#include "novaphy/core/row_stack.h"

#define NOVAPHY_ROW_SCRATCH(TYPE, NAME, MEMORY) TYPE NAME

namespace novaphy {
inline constexpr int64_t kRowStack = kHostRowStack;

// So many numbers of the thread that runs a row, until it asks again; null on devices.
inline double* thread_numbers(int64_t count) {
  static thread_local std::vector<double> numbers;
  if (numbers.size() < static_cast<size_t>(count)) numbers.resize(static_cast<size_t>(count));
  return numbers.data();
}
}  // namespace novaphy
