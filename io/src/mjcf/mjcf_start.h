// Effective masses of a Robot at its initial pose.
#pragma once

#include "../robot/robot.h"

namespace novaphy::detail {

// Returns for each joint, and each of its linear and then angular dofs, 1 over the diagonal entry
// of the inverse mass matrix at the coordinates `start`. Returns 0 if the matrix is singular.
// Parents must come before children.
std::vector<std::vector<double>> free_inertias(const Robot& robot);

// Sets ShapeMixing::inverse_mass of all shapes to MuJoCo's body_invweight0.
void set_inverse_masses(Robot& robot);

}  // namespace novaphy::detail
