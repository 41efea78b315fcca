// The solution of a step of bodies, as its derivatives read it.
#pragma once

#include <cstdint>
#include <vector>

#include "bodies.h"
#include "novaphy/vbd/differentiable_bodies.h"

namespace novaphy {

struct VbdBodySolution {
  std::vector<VbdBodyMotion> motion;
  std::vector<VbdBodyJoint> joint;  // with the multipliers at the end of the step
  std::vector<int32_t> joints;      // the index of each joint in the model
  std::vector<int32_t> is_kinematic;
  std::vector<VbdBodyContact> contact;
  std::vector<vbd::ContactOrigin> contact_origin;  // of each contact
  VbdResidual residual = {};
  bool is_solved = false;
  bool contacts_follow = false;  // whether the contacts were found from the state
};

}  // namespace novaphy
