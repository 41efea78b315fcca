// Memory of a row of a hand-written kernel that is too large for the registers of a thread of a
// device: here an object on the stack, there (core/device/) a row of an array, whose values are
// those of the last launch.
#pragma once

#include "novaphy/core/row_stack.h"

#define NOVAPHY_ROW_SCRATCH(TYPE, NAME, MEMORY) TYPE NAME

namespace novaphy {
inline constexpr int64_t kRowStack = kHostRowStack;
}  // namespace novaphy
