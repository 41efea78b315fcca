// The kernels of the coarse correction, compiled for one instruction set.
#include "lanes.h"
// Included after lanes.h, like sweep_kernels.h, because the templates use the lane functions.
#include "novaphy/vbd/coarse_kernels.h"

namespace novaphy::vbd::NOVAPHY_LEVEL {

void coarse_rows(const uint64_t* words, int64_t n, int64_t begin, int64_t end) {
  over_groups<VbdCoarseArguments, vbd::coarse_rows<Lanes>>(words, n, begin, end);
}
void coarse_force(const uint64_t* words, int64_t n, int64_t begin, int64_t end) {
  over_groups<VbdCoarseArguments, vbd::coarse_force<Lanes>>(words, n, begin, end);
}
void coarse_outer(const uint64_t* words, int64_t n, int64_t begin, int64_t end) {
  over_groups<VbdCoarseArguments, vbd::coarse_outer<Lanes>>(words, n, begin, end);
}

}  // namespace novaphy::vbd::NOVAPHY_LEVEL
