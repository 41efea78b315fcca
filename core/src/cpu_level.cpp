#include "novaphy/core/cpu_level.h"

#include <cstdlib>
#include <string_view>

#include "novaphy/core/error.h"

namespace novaphy {
namespace {

bool has(std::string_view level) {
#if defined(__x86_64__)
  if (level == "avx512") return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("fma");
  if (level == "avx2") return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
#endif
  return level == "baseline";
}

}  // namespace

size_t choose_cpu_level(std::span<const char* const> best_first) {
  const char* const variable = std::getenv("NOVAPHY_CPU_ISA");
  const std::string_view wanted = variable != nullptr ? variable : "";
  for (size_t i = 0; i < best_first.size(); ++i) {
    if (!wanted.empty() && wanted != best_first[i]) continue;
    if (has(best_first[i])) return i;
    require(wanted.empty(), ErrorKind::Runtime, "NOVAPHY_CPU_ISA=", wanted,
            ": this processor does not have it");
  }
  for (const std::string_view level : {"baseline", "avx2", "avx512"})
    require(wanted != level, ErrorKind::Runtime, "NOVAPHY_CPU_ISA=", wanted,
            ": this build does not have it");
  fail(ErrorKind::Runtime, "NOVAPHY_CPU_ISA: expected baseline, avx2 or avx512, got '", wanted,
       "'");
}

}  // namespace novaphy
