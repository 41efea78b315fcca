// NOVAPHY_ASSERT(condition) checks an invariant of the engine's own tables. Under the preset
// `debug` a broken invariant is printed and aborts the process. Other builds compile the condition
// without evaluating it. A mistake of the caller raises an Error instead.
#pragma once

#include "novaphy/core/export.h"

namespace novaphy {

// Prints the condition with its file and line to the standard error, then aborts.
[[noreturn]] NOVAPHY_CORE_API void assertion_failed(const char* condition, const char* file,
                                                    int line) noexcept;

}  // namespace novaphy

#ifdef NOVAPHY_DEBUG
#define NOVAPHY_ASSERT(...) \
  ((__VA_ARGS__) ? void() : ::novaphy::assertion_failed(#__VA_ARGS__, __FILE__, __LINE__))
#else
#define NOVAPHY_ASSERT(...) static_cast<void>(sizeof((__VA_ARGS__) ? 1 : 0))
#endif
