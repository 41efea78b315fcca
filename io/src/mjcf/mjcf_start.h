// The masses of a Robot at its start.
#pragma once

#include "../robot/robot.h"

namespace novaphy::detail {

// For each joint and each of its linear, then angular degrees of freedom: 1 over the diagonal of
// the inverse of the mass matrix where all joints are at `start`. 0: the matrix is singular.
// Parents come before children.
std::vector<std::vector<double>> free_inertias(const Robot& robot);

// ShapeMixing::inverse_mass of all shapes, as MuJoCo's body_invweight0.
void set_inverse_masses(Robot& robot);

}  // namespace novaphy::detail
