// Bytes that a row of a hand-written kernel may have on the stack: of a thread of the host, and of
// one of a device, where the stacks of a group of threads are interleaved, so that they read them
// together, and all threads that can run have theirs.
#pragma once

#include <cstdint>

namespace novaphy {
inline constexpr int64_t kHostRowStack = 16384, kDeviceRowStack = 4096;
}  // namespace novaphy
