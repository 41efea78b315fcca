// Bodies from joint coordinates (articulation/kinematics.h), and joint coordinates from bodies
// (joint_kinematics_trace.h).
#pragma once

#include "novaphy/core/device_array.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/export.h"

namespace novaphy {

// Poses and velocities, body_q and body_qd, of the children of all joints of articulations, with
// the bits of a step that ends at these coordinates; other bodies stay as they are. Quaternions in
// joint_q are made unit. Arrays: joint_q {coordinates}, joint_qd {degrees of freedom}; those of
// `state` itself may be given. ErrorKind::Value: rows that are not the model's, a state of another
// model, a quaternion of length 0, Model::check_structure. Joints that follow others stand where
// joint_q has them: eval_mimic puts them where their leaders want them.
//
// It is one launch, which a capture records, with the same bits on all devices. On a tape it raises
// for joint_q or joint_qd that carry a gradient. On a device, on a tape and in a capture a
// quaternion of length 0 gives NaN.
NOVAPHY_DYNAMICS_API void eval_fk(const Model& model, const DeviceArray<float>& joint_q,
                                  const DeviceArray<float>& joint_qd, SimState& state);

// Coordinates and rates of all joints, from body_q and body_qd. What the bodies do besides what
// their joint allows is left out. Angles are those in [-pi, pi]: turns are not counted.
// Errors as eval_fk; ErrorKind::NotImplemented, naming the joint: a D6 whose axes are not
// perpendicular. It is one launch, as eval_fk; on a tape it raises for poses and velocities that
// carry a gradient.
NOVAPHY_DYNAMICS_API void eval_ik(const Model& model, const SimState& state,
                                  DeviceArray<float> joint_q, DeviceArray<float> joint_qd);

// Coordinates and rates of joints that follow others (ModelBuilder::add_constraint_mimic) from
// those of their leaders, as a step writes them; the others stay. Errors, tapes and devices as
// eval_fk.
NOVAPHY_DYNAMICS_API void eval_mimic(const Model& model, DeviceArray<float> joint_q,
                                     DeviceArray<float> joint_qd);

}  // namespace novaphy
