// Chooses between versions of code that are compiled once for each CPU instruction set.
#pragma once

#include <array>
#include <cstddef>
#include <span>

#include "novaphy/core/export.h"

namespace novaphy {

// Returns the index of the instruction set to use. NOVAPHY_CPU_ISA ("avx512", "avx2" or "baseline")
// names the level. Without the variable, the first level that the processor supports is chosen.
// Throws ErrorKind::Runtime if the variable has another value, or names a level that the processor
// or the build lacks.
NOVAPHY_CORE_API size_t choose_cpu_level(std::span<const char* const> best_first);

// Returns the chosen element of a list of levels, each of which has a member `name`.
template <class Level, size_t count>
const Level& choose_cpu_level(const std::array<const Level*, count>& best_first) {
  std::array<const char*, count> names;
  for (size_t i = 0; i < count; ++i) names[i] = best_first[i]->name;
  return *best_first[choose_cpu_level(std::span<const char* const>(names))];
}

}  // namespace novaphy
