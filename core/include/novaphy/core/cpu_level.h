// Code that is compiled once for each instruction set: which of them runs.
#pragma once

#include <array>
#include <cstddef>
#include <span>

#include "novaphy/core/export.h"

namespace novaphy {

// The place of the level that NOVAPHY_CPU_ISA names, else of the first that this processor has,
// among "avx512", "avx2" and "baseline". ErrorKind::Runtime: the variable names none of these, or
// one that the processor or the build has not.
NOVAPHY_CORE_API size_t choose_cpu_level(std::span<const char* const> best_first);

// The same of levels with a name.
template <class Level, size_t count>
const Level& choose_cpu_level(const std::array<const Level*, count>& best_first) {
  std::array<const char*, count> names;
  for (size_t i = 0; i < count; ++i) names[i] = best_first[i]->name;
  return *best_first[choose_cpu_level(std::span<const char* const>(names))];
}

}  // namespace novaphy
