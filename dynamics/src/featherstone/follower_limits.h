// Limits of joints that follow others, which JointLimits::Row does not support.
#pragma once

#include <array>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"

namespace novaphy {

class FollowerLimits {
 public:
  // ErrorKind::NotImplemented: a joint that follows another one has a limit. Arrays are checked
  // again when they were written.
  void check(const Model& model, const FeatherstoneOptions& options, const char* user);

 private:
  std::array<ArrayStamp, 3> checked_;
};

}  // namespace novaphy
