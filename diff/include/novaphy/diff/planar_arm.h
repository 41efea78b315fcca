// The planar arm of two links in closed form: the recorder of its steps, and the loss of its tip.
//
// Two hinges about +Y, links in XOZ: c_i from joint i to the center of mass of link i along x, l
// from joint 1 to joint 2. With k = m2 l c2, A = (m1 c1 + m2 l) g, B = m2 c2 g, g > 0 downwards:
//   M11 = I1 + m1 c1^2 + m2 l^2 + I2 + m2 c2^2 + 2 k cos q2 + armature1
//   M12 = I2 + m2 c2^2 + k cos q2,  M22 = I2 + m2 c2^2 + armature2
//   a = M^-1 (t - h - G),  h = (-k sin q2 v2 (2 v1 + v2), k sin q2 v1^2)
//   G = (-(A cos q1 + B cos q12), -B cos q12)
//   u = v + dt a,  q' = q + dt u,  v' = (1 - angular_damping dt) u
// Here t is the limits' force. The result is that of SolverFeatherstone, which each call checks.
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
// ErrorKind::Runtime, with the first condition that is not met: the arm above; no drives, damping,
// friction, joint_f, joint_act or body_f; values within 5e-6 + 2e-6 |value| of the closed form.
NOVAPHY_DIFF_API void record_planar_2r_featherstone_step(
    const Model& model, const SimState& state_in, const Control* control, const nova::Tensor& q,
    const nova::Tensor& qd, const nova::Tensor& q_out, const nova::Tensor& qd_out, float dt,
    float angular_damping);

// Returns |tip - target|^2 {1} (m^2) at q {2}. The distance of the tip from joint 2 is twice c2.
NOVAPHY_DIFF_API nova::Tensor planar_2r_tip_loss(const Model& model, const nova::Tensor& q,
                                                 float target_x, float target_z);

}  // namespace novaphy::diff
