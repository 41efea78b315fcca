// The kernels of a sweep in reverse, compiled for one instruction set.
#include "lanes.h"
// Included after lanes.h, like sweep_kernels.h, because the templates use the lane functions.
#include "novaphy/vbd/coarse_adjoint_kernels.h"

namespace novaphy::vbd::NOVAPHY_LEVEL {

void adjoint(const uint64_t* words, int64_t n, int64_t begin, int64_t end) {
  over_groups<VbdAdjointArguments, reverse_group<Lanes>>(words, n, begin, end);
}
void adjoint_outer(const uint64_t* words, int64_t n, int64_t begin, int64_t end) {
  over_groups<VbdAdjointArguments, reverse_outer<Lanes>>(words, n, begin, end);
}
void adjoint_stiffness(const uint64_t* words, int64_t n, int64_t begin, int64_t end) {
  over_groups<VbdAdjointArguments, reverse_stiffness<Lanes>>(words, n, begin, end);
}
void tangent_stiffness(const uint64_t* words, int64_t n, int64_t begin, int64_t end) {
  over_groups<VbdTangentArguments, vbd::tangent_stiffness<Lanes>>(words, n, begin, end);
}
void adjoint_start(const uint64_t* words, int64_t n, int64_t begin, int64_t end) {
  over_groups<VbdAdjointArguments, reverse_group_start<Lanes>>(words, n, begin, end);
}

}  // namespace novaphy::vbd::NOVAPHY_LEVEL
