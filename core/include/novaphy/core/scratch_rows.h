// The size of the scratch memory of rows (row_scratch.h).
#pragma once

#include <cstddef>

#include "novaphy/core/device.h"

namespace novaphy {

// Returns how many of `rows` need scratch memory: none on the CPU, where a row uses the stack.
inline size_t scratch_rows(Device device, size_t rows) { return device.is_cpu() ? 0 : rows; }

}  // namespace novaphy
