// Writes the settings of ModelBuilder::add_joint_ball.
#pragma once

#include <string_view>

#include "novaphy/core/sim/joint_args.h"
#include "novaphy/core/sim/model_builder.h"

namespace novaphy::detail {

void check_ball(std::string_view name, const BallJointArgs& args);
// Writes the settings to the joint that was added last.
void set_ball(ModelBuilder& builder, const BallJointArgs& args);

}  // namespace novaphy::detail
