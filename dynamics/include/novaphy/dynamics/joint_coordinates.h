// Conversion from joint coordinates to bodies (articulation/kinematics.h), and from bodies to joint
// coordinates (joint_kinematics_trace.h).
#pragma once

#include "novaphy/core/device_array.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/export.h"

namespace novaphy {

// Computes body_q and body_qd of the children of all joints of articulations, with the bits of a
// step that ends at these coordinates. Other bodies are unchanged. Quaternions in joint_q are
// normalized. Arrays: joint_q {coordinates}, joint_qd {degrees of freedom}; they may be those of
// `state`. The coordinates of mimic joints are used as they are; eval_mimic sets them from their
// leaders. ErrorKind::Value: rows that are not the model's, a state of another model, a quaternion
// of length 0, or an error of Model::check_structure.
//
// The function is one launch, which a capture records, with the same bits on all devices. On a tape
// it throws if joint_q or joint_qd carries a gradient. On a device, on a tape and in a capture a
// quaternion of length 0 gives NaN.
NOVAPHY_DYNAMICS_API void eval_fk(const Model& model, const DeviceArray<float>& joint_q,
                                  const DeviceArray<float>& joint_qd, SimState& state);

// Computes the coordinates and rates of all joints from body_q and body_qd. Motions of the bodies
// that violate a joint are ignored. Angles are in [-pi, pi], without counting turns.
// ErrorKind::NotImplemented, with the joint: a D6 with axes that are not perpendicular. Other
// errors as for eval_fk. The function is one launch, as eval_fk. On a tape it throws if poses or
// velocities carry a gradient.
NOVAPHY_DYNAMICS_API void eval_ik(const Model& model, const SimState& state,
                                  DeviceArray<float> joint_q, DeviceArray<float> joint_qd);

// Sets the coordinates and rates of mimic joints (ModelBuilder::add_constraint_mimic) from those of
// their leaders, as a step does. Other joints are unchanged. Errors, tapes and devices as for
// eval_fk.
NOVAPHY_DYNAMICS_API void eval_mimic(const Model& model, DeviceArray<float> joint_q,
                                     DeviceArray<float> joint_qd);

}  // namespace novaphy
