// The forces of VBD and their derivative along a direction on devices (sweep_tangent_kernels.h), a
// thread for each particle.
#pragma once

#include "novaphy/vbd/sweep_tangent_kernels.h"

namespace novaphy {

NOVAPHY_BLOCK_KERNEL(vbd_tangent, VbdTangentArguments);
NOVAPHY_BLOCK_KERNEL(vbd_tangent_start, VbdTangentArguments);

struct VbdTangentMoveArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> particle, filled; Number<int64_t> first_group, lanes;
                    Reads<VbdRow> step; Updates<VbdRow> x;)
};
// The particles of a colour take their steps. `row`: over the lanes of its groups.
NOVAPHY_ROW_KERNEL(vbd_tangent_move, VbdTangentMoveArguments) {
  const int64_t of_color = row / a.lanes, group = a.first_group + of_color;
  if (row - of_color * a.lanes >= a.filled[group]) return;
  const int32_t p = a.particle[a.first_group * a.lanes + row];
  a.x[p] = to_row(to_vec3(a.x[p]) + to_vec3(a.step[p]));
}

#ifdef NOVAPHY_KERNEL
namespace vbd {
// Calls body(lane) for the row of a launch that a thread is.
template <class Body>
inline void for_lane(const VbdSweepArguments& a, int64_t block, const Body& body) {
  const int64_t row = block * 128 + static_cast<int64_t>(threadIdx.x);
  if (row < (a.end_group - a.first_group) * kVbdLanes) body(LaneGroup<float>(a, row));
}
}  // namespace vbd

NOVAPHY_BLOCK_BODY(vbd_tangent, VbdTangentArguments) {
  vbd::for_lane(a.sweep, block, [&](const auto& lane) { vbd::tangent(a, lane); });
}
NOVAPHY_BLOCK_BODY(vbd_tangent_start, VbdTangentArguments) {
  vbd::for_lane(a.sweep, block, [&](const auto& lane) { vbd::tangent_start(a, lane); });
}
#endif

}  // namespace novaphy
