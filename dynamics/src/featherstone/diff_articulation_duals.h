// The arguments of a step of articulations with dual numbers, for its tangent.
#pragma once

#include "diff_articulation_parts.h"

namespace novaphy::diff::detail {

using articulation::DualFloat;

// Over `take(values, tangent)`, the dual numbers of an array; an undefined tangent is 0. `t`: of
// the inputs. `from` (null: the step's inputs): the state that it starts from. Indices are those of
// the step.
template <class Take>
ArticulationArgumentsOf<DualFloat> dual_arguments(const Step& s, const StepOutputs* from,
                                                  std::span<const Tensor> t, const Take& take) {
  const auto in = [&](size_t m) { return take(s.in(m), t[m]); };
  const auto indices = [&](size_t i) {
    return static_cast<const int32_t*>(s.values[i].tensor.range()->data());
  };
  const auto constant = [&](size_t i) { return take(s.values[i].tensor, Tensor()); };
  ArticulationArgumentsOf<DualFloat> a;
  a.rows = reinterpret_cast<const ArticulationRows*>(indices(0));
  a.links = reinterpret_cast<const articulation::Link*>(indices(1));
  a.dof_parent = indices(2);
  a.X_p = reinterpret_cast<const Transform<DualFloat>*>(constant(3));
  a.X_c = reinterpret_cast<const Transform<DualFloat>*>(constant(4));
  a.axis = reinterpret_cast<const Vec3<DualFloat>*>(constant(5));
  a.mass = in(G::kMass);
  a.com = reinterpret_cast<const Vec3<DualFloat>*>(in(G::kCom));
  a.inertia = reinterpret_cast<const Mat33<DualFloat>*>(in(G::kInertia));
  a.gravity = reinterpret_cast<const Vec3<DualFloat>*>(in(kGravity));
  a.target_mode = indices(6);
  a.target_q = in(G::kTargetQ);
  a.target_qd = in(G::kTargetQd);
  a.target_ke = in(G::kTargetKe);
  a.target_kd = in(G::kTargetKd);
  a.damping = in(G::kDamping);
  a.armature = in(G::kArmature);
  a.limit_lower = in(G::kLimitLower);
  a.limit_upper = in(G::kLimitUpper);
  a.limit_ke = in(G::kLimitKe);
  a.limit_kd = in(G::kLimitKd);
  a.effort_limit = in(G::kEffortLimit);
  a.velocity_limit = in(G::kVelocityLimit);
  a.q = take(from ? (*from)[0] : s.in(G::kQ), t[G::kQ]);
  a.qd = take(from ? (*from)[1] : s.in(G::kQd), t[G::kQd]);
  a.joint_f = in(G::kJointF);
  a.body_f = reinterpret_cast<const SpatialVector<DualFloat>*>(in(G::kBodyF));
  a.dt = {s.dt, 0};
  a.angular_damping = {s.options.angular_damping, 0};
  a.implicit_drives = s.options.implicit_drives ? 1 : 0;
  return a;
}

// The tangents of a step on a device, by launches, which a capture records.
void launch_jvp(const Step& s, std::span<const Tensor> inputs, std::span<const Tensor> outputs);

}  // namespace novaphy::diff::detail
