// Joint limits as springs between bodies. Gradients of the motion do not move the times of these
// limits (diff_touches.h), so they are only counted.
#include <cstdint>

#include "diff_touch_motion.h"
#include "novaphy/core/sim/joint_types.h"
#include "novaphy/dynamics/joint_kinematics_trace.h"
#include "novaphy/dynamics/semi_implicit/penalty_joint_trace.h"

namespace novaphy::diff {

namespace {

// Calls visit(dof, q) for each coordinate of a joint that has limits.
template <class F>
void for_limited(const Model& m, int32_t joint, const JointFrames<float>& at, const F& visit) {
  const auto type = static_cast<JointType>(m.joint_type.data()[joint]);
  const int32_t first = m.joint_qd_start.data()[joint];
  if (joint_traits(type).constraint == JointConstraint::DISTANCE)
    return visit(first, math::length(at.x));
  if (!has_axes(type)) return;
  const Vec2i dims = m.joint_dof_dim.data()[joint];
  const Vec3f* const axis = m.joint_axis.data() + first;
  for (int32_t k = 0; k < dims.x; ++k)
    visit(first + k, math::dot(at.x, math::rotate(at.parent.q, axis[k])));
  if (dims.y == 0) return;
  const Vec3f* const turn = axis + dims.x;
  const Vec3f axes[3] = {turn[0], turn[dims.y > 1 ? 1 : 0], turn[dims.y - 1]};
  const JointAngles<float> angles = joint_angles(at.r, axes, dims.y);
  for (int32_t k = 0; k < dims.y; ++k) visit(first + dims.x + k, angles.q[k]);
}

}  // namespace

int64_t TouchMotion::Impl::find_limits(const Model& m, const SimState& state, bool follows_last) {
  if (!settings.jointed) return 0;
  const auto body = [&](int32_t b) {
    return b < 0 ? JointBody<float>{}
                 : JointBody<float>{state.body_q.data()[b], state.body_qd.data()[b],
                                    m.body_com.data()[b]};
  };
  const float *const lower = m.joint_limit_lower.data(), *const upper = m.joint_limit_upper.data();
  std::vector<char> sides(static_cast<size_t>(m.joint_dof_count()));
  for (int32_t j = 0; j < m.joint_count(); ++j) {
    if (m.joint_enabled.data()[j] == 0) continue;
    const JointFrames<float> frames =
        joint_frames(body(m.joint_parent.data()[j]), body(m.joint_child.data()[j]),
                     m.joint_X_p.data()[j], m.joint_X_c.data()[j]);
    for_limited(m, j, frames, [&](int32_t dof, float q) {
      if (m.joint_limit_ke.data()[dof] == 0.0f && m.joint_limit_kd.data()[dof] == 0.0f) return;
      sides[static_cast<size_t>(dof)] = q < lower[dof] ? -1 : q > upper[dof] ? 1 : 0;
    });
  }
  int64_t changed = 0;
  for (size_t k = 0; follows_last && k < sides.size(); ++k)
    changed += sides[k] != limit_sides[k] ? 1 : 0;
  limit_sides = std::move(sides);
  return changed;
}

}  // namespace novaphy::diff
