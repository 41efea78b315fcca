// The sweep of one instruction set along a direction.
#include "lanes.h"
// Behind lanes.h, as sweep_kernels.h.
#include "novaphy/vbd/sweep_tangent_kernels.h"

namespace novaphy::vbd::NOVAPHY_LEVEL {

const GroupKernel kTangent = over_groups<VbdTangentArguments, vbd::tangent<Lanes>>;
const GroupKernel kTangentStart = over_groups<VbdTangentArguments, vbd::tangent_start<Lanes>>;

}  // namespace novaphy::vbd::NOVAPHY_LEVEL
