// The solution of a step of bodies, as its derivatives read it.
#pragma once

#include <cstdint>
#include <vector>

#include "bodies_kernels.h"
#include "novaphy/vbd/differentiable_bodies.h"

namespace novaphy {

struct VbdBodySolution {
  std::vector<VbdBodyMotion> motion;
  std::vector<VbdBodyJoint> joint;  // with the multipliers at the end of the step
  std::vector<int32_t> joints;      // the index of each joint in the model
  std::vector<int32_t> is_kinematic;
  VbdResidual residual = {};
  bool is_solved = false;
};

}  // namespace novaphy
