// The kernels of the tangent of a sweep, compiled for one instruction set.
#include "lanes.h"
// Included after lanes.h, like sweep_kernels.h, because the templates use the lane functions.
#include "novaphy/vbd/sweep_tangent_kernels.h"

namespace novaphy::vbd::NOVAPHY_LEVEL {

void tangent(const uint64_t* words, int64_t n, int64_t begin, int64_t end) {
  over_groups<VbdTangentArguments, vbd::tangent<Lanes>>(words, n, begin, end);
}
void tangent_start(const uint64_t* words, int64_t n, int64_t begin, int64_t end) {
  over_groups<VbdTangentArguments, vbd::tangent_start<Lanes>>(words, n, begin, end);
}

}  // namespace novaphy::vbd::NOVAPHY_LEVEL
