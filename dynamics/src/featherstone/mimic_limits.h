// The check for mimic joints with limits, which JointLimits::Row does not support.
#pragma once

#include <array>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"

namespace novaphy {

class MimicLimits {
 public:
  // Throws ErrorKind::NotImplemented, with `user`, if a mimic joint has a limit and the options
  // have JointLimits::Row. Arrays are checked again after a write.
  void check(const Model& model, const FeatherstoneOptions& options, const char* user);

 private:
  std::array<ArrayStamp, 3> checked_;
};

}  // namespace novaphy
