// NOVAPHY_ASSERT(condition): an invariant of the engine's own tables. The preset `debug` checks it,
// prints a broken one and aborts; other builds compile the condition and do not evaluate it. A
// mistake of a caller is an Error instead.
#pragma once

#include "novaphy/core/export.h"

namespace novaphy {

// Prints to the standard error and aborts.
[[noreturn]] NOVAPHY_CORE_API void assertion_failed(const char* condition, const char* file,
                                                    int line) noexcept;

}  // namespace novaphy

#ifdef NOVAPHY_DEBUG
#define NOVAPHY_ASSERT(...) \
  ((__VA_ARGS__) ? void() : ::novaphy::assertion_failed(#__VA_ARGS__, __FILE__, __LINE__))
#else
#define NOVAPHY_ASSERT(...) static_cast<void>(sizeof((__VA_ARGS__) ? 1 : 0))
#endif
