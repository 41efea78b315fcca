// The forces of VBD and their tangents along a direction on devices (sweep_tangent_kernels.h), with
// one thread for each particle.
#pragma once

#include "novaphy/vbd/sweep_tangent_kernels.h"

namespace novaphy {

// A row is a lane of the groups of the launch.
NOVAPHY_ROW_KERNEL(vbd_tangent, VbdTangentArguments) {
  vbd::tangent(a, vbd::LaneGroup<float>(a.sweep, row));
}
NOVAPHY_ROW_KERNEL(vbd_tangent_start, VbdTangentArguments) {
  vbd::tangent_start(a, vbd::LaneGroup<float>(a.sweep, row));
}

struct VbdTangentMoveArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> particle, filled; Number<int64_t> first_group, lanes;
                    Reads<VbdRow> step; Updates<VbdRow> x;)
};
// Adds the tangents of the steps of a color's particles to x. A row is a lane of the color's
// groups.
NOVAPHY_ROW_KERNEL(vbd_tangent_move, VbdTangentMoveArguments) {
  const int64_t of_color = row / a.lanes, group = a.first_group + of_color;
  if (row - of_color * a.lanes >= a.filled[group]) return;
  const int32_t p = a.particle[a.first_group * a.lanes + row];
  a.x[p] = to_row(to_vec3(a.x[p]) + to_vec3(a.step[p]));
}

}  // namespace novaphy
