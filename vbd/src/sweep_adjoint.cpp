// The sweep of one instruction set in reverse.
#include "lanes.h"
// Behind lanes.h, as sweep_kernels.h.
#include "novaphy/vbd/sweep_adjoint_kernels.h"

namespace novaphy::vbd::NOVAPHY_LEVEL {

const GroupKernel kAdjoint = over_groups<VbdAdjointArguments, reverse_group<Lanes>>;
const GroupKernel kAdjointStart = over_groups<VbdAdjointArguments, reverse_group_start<Lanes>>;

}  // namespace novaphy::vbd::NOVAPHY_LEVEL
