// Memory of a row of a hand-written kernel that is too large for the registers of a thread of a
// device: here an object on the stack, there (core/device/) a row of an array, whose values are
// those of the last launch.
#pragma once

#include <cstdint>

#define NOVAPHY_ROW_SCRATCH(TYPE, NAME, MEMORY) TYPE NAME

namespace novaphy {
// Bytes that a row may have on the stack: here, and on a device, where the stacks of a group of
// threads are interleaved, so that they read them together, and all that can run have theirs.
inline constexpr int64_t kRowStack = 16384, kDeviceRowStack = 4096;
}  // namespace novaphy
