// Forward kinematics (articulation/kinematics.h): body poses from joint coordinates. Inverse
// kinematics of each joint (joint_kinematics_trace.h): joint coordinates from body poses.
#pragma once

#include "novaphy/core/device_array.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/export.h"

namespace novaphy {

// Computes body_q and body_qd of the children of all joints of articulations. The bits equal those
// of a step that ends at these coordinates. All other bodies stay unchanged. Quaternions in joint_q
// are normalized. joint_q {coordinates} and joint_qd {dofs} may be the arrays of `state`. The
// coordinates of mimic joints are used as given; eval_mimic computes them from their leaders.
// ErrorKind::Value: arrays of another size than the model's, a state of another model, a quaternion
// of length 0, or an error of Model::check_structure.
//
// The function is one launch with the same bits on all devices. A capture records it. On a tape the
// function throws if joint_q or joint_qd carries a gradient. On a device, on a tape and in a
// capture, a quaternion of length 0 gives NaN instead of an error.
NOVAPHY_DYNAMICS_API void eval_fk(const Model& model, const DeviceArray<float>& joint_q,
                                  const DeviceArray<float>& joint_qd, SimState& state);

// Computes the coordinates and rates of all joints from body_q and body_qd. The part of a body's
// motion that violates its joint is ignored. Angles are in [-pi, pi], without full turns. The
// function is one launch, as eval_fk. On a tape it throws if poses or velocities carry a gradient.
// ErrorKind::NotImplemented, with the joint: a D6 joint with axes that are not perpendicular. Other
// errors as for eval_fk.
NOVAPHY_DYNAMICS_API void eval_ik(const Model& model, const SimState& state,
                                  DeviceArray<float> joint_q, DeviceArray<float> joint_qd);

// Sets the coordinates and rates of mimic joints (ModelBuilder::add_constraint_mimic) from those of
// their leaders, as a step does. Other joints stay unchanged. Errors and the behavior on tapes and
// devices are those of eval_fk.
NOVAPHY_DYNAMICS_API void eval_mimic(const Model& model, DeviceArray<float> joint_q,
                                     DeviceArray<float> joint_qd);

}  // namespace novaphy
