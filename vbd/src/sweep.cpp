#include "sweep.h"

#include <cstdlib>
#include <string_view>

#include "novaphy/core/error.h"

namespace novaphy::vbd {

namespace baseline {
extern const SweepLevel kLevel;
}
#ifdef NOVAPHY_VBD_X86
namespace avx2 {
extern const SweepLevel kLevel;
}
namespace avx512 {
extern const SweepLevel kLevel;
}
#endif

namespace {

struct Choice {
  const SweepLevel& level;
  bool available;
};

}  // namespace

const SweepLevel& sweep_level() {
  const Choice best_first[] = {
#ifdef NOVAPHY_VBD_X86
      {avx512::kLevel, __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("fma")},
      {avx2::kLevel, __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")},
#endif
      {baseline::kLevel, true}};
  const char* const variable = std::getenv("NOVAPHY_CPU_ISA");
  const std::string_view wanted = variable != nullptr ? variable : "";
  for (const Choice& choice : best_first) {
    if (!wanted.empty() && wanted != choice.level.name) continue;
    if (choice.available) return choice.level;
    require(wanted.empty(), ErrorKind::Runtime, "NOVAPHY_CPU_ISA=", wanted,
            ": this processor does not have it");
  }
  fail(ErrorKind::Runtime, "NOVAPHY_CPU_ISA: expected baseline, avx2 or avx512, got '", wanted,
       "'");
}

}  // namespace novaphy::vbd
