// The bytes that a row of a hand-written kernel may have on the stack, for a thread of the host and
// for a thread of a device. On a device the stacks of a group of threads are interleaved, so that
// the threads read together. All threads that can run have a stack.
#pragma once

#include <cstdint>

namespace novaphy {
inline constexpr int64_t kHostRowStack = 16384, kDeviceRowStack = 4096;
}  // namespace novaphy
