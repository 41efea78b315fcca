// The forces of the contacts of particles in a step of VBD, on the host, for AdjointRecord.
#pragma once

#include <span>
#include <vector>

#include "rows.h"
#include "step.h"
#include "step_tangent.h"

namespace novaphy::vbd {

// Returns the forces at the end of the last run, in the order of the particles. `end`: positions
// there. `along`: the direction of the tangents; null: the tangents are 0. x_tangents: of `end`.
std::vector<VbdContactForce> contact_forces(const Step& step, const StepInputs& in,
                                            const std::vector<Vec3f>& end,
                                            const SweepTangents* along, const Rows& x_tangents);
// Returns the rows of `held` (DifferentiableVbd::tangent) in the order of Step::contact_items.
std::vector<int32_t> held_contacts(const Step& step, std::span<const int32_t> held);

}  // namespace novaphy::vbd
