#include "sweep.h"

#include <array>

#include "novaphy/core/cpu_level.h"

namespace novaphy::vbd {

namespace baseline {
extern const SweepLevel kLevel;
}
#ifdef NOVAPHY_X86_LEVELS
namespace avx2 {
extern const SweepLevel kLevel;
}
namespace avx512 {
extern const SweepLevel kLevel;
}
#endif

namespace {
constexpr std::array kLevels = {
#ifdef NOVAPHY_X86_LEVELS
    &avx512::kLevel, &avx2::kLevel,
#endif
    &baseline::kLevel};
}  // namespace

const SweepLevel& sweep_level() { return choose_cpu_level(kLevels); }

const SweepLevel& sweep_level_of(int64_t lanes) {
  for (const SweepLevel* level : kLevels)
    if (level->lanes == lanes) return *level;
  return baseline::kLevel;
}

}  // namespace novaphy::vbd
