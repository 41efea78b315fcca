// The planar arm of two links in closed form: records its steps on a tape, and computes a loss of
// its tip.
//
// Both hinges turn about +Y, and the links lie in the plane XOZ. The center of mass of link i is at
// distance c_i (m) along x from joint i. Joint 2 is at distance l (m) from joint 1. Angles (rad)
// are q_i, their rates v_i, and q12 = q1 + q2. Gravity g > 0 (m/s^2) points downwards. With k = m2
// l c2, A = (m1 c1 + m2 l) g and B = m2 c2 g:
//   M11 = I1 + m1 c1^2 + m2 l^2 + I2 + m2 c2^2 + 2 k cos q2 + armature1
//   M12 = I2 + m2 c2^2 + k cos q2,  M22 = I2 + m2 c2^2 + armature2
//   a = M^-1 (t - h - G),  h = (-k sin q2 v2 (2 v1 + v2), k sin q2 v1^2)
//   G = (-(A cos q1 + B cos q12), -B cos q12)
//   u = v + dt a,  q' = q + dt u,  v' = (1 - angular_damping dt) u
// M is the mass matrix, h the Coriolis and centrifugal torque, G that of gravity and t that of the
// limits (N m). The result is that of SolverFeatherstone, which each call checks.
#pragma once

#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/diff/export.h"
#include "novaphy/nova/tensor.h"

namespace novaphy::diff {

// Records on an active tape a step that SolverFeatherstone (with implicit drives) has just made.
// The step begins at state_in, whose joint_q and joint_qd are q and qd, and ends at q_out and
// qd_out. All four are {2}. Gradients are exact for q and qd. Without a tape the call only checks.
// ErrorKind::Runtime names the first condition that is not met. The model must be the arm above,
// without drives, damping, friction, joint_f, joint_act or body_f. The results of the step must be
// within 5e-6 + 2e-6 |value| of the closed form.
NOVAPHY_DIFF_API void record_planar_2r_featherstone_step(
    const Model& model, const SimState& state_in, const Control* control, const nova::Tensor& q,
    const nova::Tensor& qd, const nova::Tensor& q_out, const nova::Tensor& qd_out, float dt,
    float angular_damping);

// Returns |tip - target|^2 {1} (m^2) at q {2}. The distance of the tip from joint 2 is twice c2.
NOVAPHY_DIFF_API nova::Tensor planar_2r_tip_loss(const Model& model, const nova::Tensor& q,
                                                 float target_x, float target_z);

}  // namespace novaphy::diff
