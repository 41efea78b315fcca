#include "sweep.h"

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

const SweepLevel& sweep_level() {
  return choose_cpu_level(std::to_array<const SweepLevel*>({
#ifdef NOVAPHY_X86_LEVELS
      &avx512::kLevel, &avx2::kLevel,
#endif
      &baseline::kLevel}));
}

}  // namespace novaphy::vbd
