// The number of bytes on the stack of one row of a hand-written kernel, on the host and on a
// device. Every device thread that can run has a stack. The stacks of a group of threads are
// interleaved, so that the threads read neighboring memory together.
#pragma once

#include <cstdint>

namespace novaphy {
inline constexpr int64_t kHostRowStack = 16384, kDeviceRowStack = 4096;
}  // namespace novaphy
