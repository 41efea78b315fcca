// The wrenches of a penalty joint: springs and dampers hold its two bodies together.
//
// Symbols, world frame unless stated otherwise:
//   X_p, X_c      the joint frame as it moves with the parent and with the child, m
//   x, v, w       position of the child's anchor from the parent's, velocities of the child
//                 relative to the parent: at the child's anchor (m/s), and angular (rad/s)
//   r             rotation of X_c in X_p
//   k, c          joint_attach_ke, joint_attach_kd: N/m, N*s/m, and N*m/rad, 0.01 c N*m*s/rad
//   a_i           axes of the degrees of freedom; joint frame of the parent
// Law, for the wrench (f, t) that the parent gets at the anchor and the child gets reversed:
//   degree of freedom q, qd: its force is
//     tau = limit + drive - damping qd,  and the child gets tau + joint_f along it
//     limit: see joint_limit_trace.h
//     drive = target_ke (target_q - q) + target_kd (target_qd - qd), at most effort_limit, and none
//             outside of the limits
//   linear axes: q_i = x . a_i. The parts of x and v across the axes get the spring k and the
//     damper c. The parent's force acts at the child's anchor, so the two forces act in one line.
//   angular axes, of r:
//     none    t = 2 atan2(|vec r|, w) unit(vec r) k + 0.01 c w. The sign of r is chosen for the
//             shorter rotation
//     one     q = 2 atan2(a . vec r, w) in [-pi, pi]; t = (a_p x a_c) k + 0.01 c (w - a qd)
//     two, three   perpendicular: q are the angles of r = R(a_0, q_0) R(a_1, q_1) R(a_2, q_2), with
//             forces along the dual basis of the rotated axes (determinant at least 1e-4: at q_1 =
//             +-pi/2 the axes lie in a plane). With two axes, k and 0.01 c act about the third
//     BALL    only damping and joint_f, about the axes of the parent's joint frame
//   DISTANCE: l = |x|; f = unit(x) (ke (l - upper) + kd dl/dt) where l > upper, likewise where
//     l < lower, 0 between, and 0 where l = 0
// Source: Newton 1.8.0, SolverSemiImplicit. Differences in Newton: DISTANCE has no force, angles
// wrap at a full turn, and FIXED takes the longer rotation for w < 0. If a slide is displaced, the
// force on its parent acts at the parent's anchor, which creates momentum. Revolute joints agree
// with Newton to rounding.
//
// Gradient: exact in all inputs but the modes, away from the kinks. At limits and at effort_limit
// the gradient is that of the side on which the value is. At r = identity and l = 0 the gradient is
// the finite limit.
//
// Freestanding: T = float runs in the forward solver, T = nova::Real can be traced.
#pragma once

#include "novaphy/dynamics/joint_kinematics_trace.h"
#include "novaphy/dynamics/semi_implicit/joint_limit_trace.h"
#include "novaphy/math/functions.h"
#include "novaphy/math/spatial.h"
#include "novaphy/math/types.h"

namespace novaphy {

template <class T>
struct JointBody {
  Transform<T> q = Transform<T>::identity();
  SpatialVector<T> qd{};
  Vec3<T> com{};  // body frame
};

// The parameters of a degree of freedom. select_drive applies the target mode to the drive's
// members.
template <class T>
struct JointDof {
  Vec3<T> axis{};  // unit vector, joint frame of the parent
  T force{};       // joint_f
  JointLimit<T> limit{};
  T target_q{}, target_qd{}, target_ke{}, target_kd{};
  T damping{}, effort_limit{};
};

// Calls visit(member of d, field of each of `a`...) for each parameter of a degree of freedom. `a`:
// structs with the fields of StepArrays (articulation/step_arrays.h).
template <class Visit, class T, class... Arrays>
void for_each_dof_number(const Visit& visit, JointDof<T>& d, Arrays&... a) {
  visit(d.force, a.joint_f...);
  for_each_limit_number(visit, d.limit, a...);
  visit(d.target_q, a.target_q...);
  visit(d.target_qd, a.target_qd...);
  visit(d.target_ke, a.target_ke...);
  visit(d.target_kd, a.target_kd...);
  visit(d.damping, a.damping...);
  visit(d.effort_limit, a.effort_limit...);
}
// Sets each parameter of the drive that the target mode does not use to 0.
template <class T, class Bool>
void select_drive(const Bool& position, const Bool& velocity, JointDof<T>& d) {
  using math::either;
  using math::select;
  const T zero = T(0.0f);
  d.target_q = select(position, d.target_q, zero);
  d.target_qd = select(velocity, d.target_qd, zero);
  d.target_ke = select(position, d.target_ke, zero);
  d.target_kd = select(either(position, velocity), d.target_kd, zero);
}

template <class T>
struct JointAttach {
  T ke{}, kd{};
};

// The wrenches on parent and child, each about its center of mass (N, N*m; world frame).
template <class T>
struct JointWrench {
  SpatialVector<T> parent{}, child{};
};

template <class T>
struct JointFrames {
  Transform<T> parent{}, child{};  // X_p, X_c
  Vec3<T> arm_p{}, arm_c{};        // anchors from the centers of mass
  Vec3<T> x{}, v{}, w{};
  Vec3<T> w_p{};
  Quat<T> r{};
};

template <class T>
JointFrames<T> joint_frames(const JointBody<T>& parent, const JointBody<T>& child,
                            const Transform<T>& x_p, const Transform<T>& x_c) {
  using namespace math;
  JointFrames<T> j;
  j.parent = multiply(parent.q, x_p);
  j.child = multiply(child.q, x_c);
  j.arm_p = j.parent.p - transform_point(parent.q, parent.com);
  j.arm_c = j.child.p - transform_point(child.q, child.com);
  j.x = j.child.p - j.parent.p;
  j.v = (child.qd.linear + cross(child.qd.angular, j.arm_c)) -
        (parent.qd.linear + cross(parent.qd.angular, j.arm_p));
  j.w = child.qd.angular - parent.qd.angular;
  j.w_p = parent.qd.angular;
  j.r = multiply(conjugate(j.parent.q), j.child.q);
  return j;
}

// Returns the force tau of a degree of freedom.
template <class T>
T joint_dof_force(const JointDof<T>& d, const T& q, const T& qd) {
  const T limit = limit_force(d.limit, q, qd);
  const T wanted = d.target_ke * (d.target_q - q) + d.target_kd * (d.target_qd - qd);
  const T drive = math::clamp(wanted, -d.effort_limit, d.effort_limit);
  return (limit + within_limits(d.limit, q, drive)) - d.damping * qd;
}

namespace joint_detail {

template <class T>
Vec3<T> no_vector() {
  return {T(0.0f), T(0.0f), T(0.0f)};
}

// Returns the rotation vector of r (rad), of the shorter rotation.
template <class T>
Vec3<T> rotation_vector(const Quat<T>& r) {
  using namespace math;
  const T one = T(1.0f), two = T(2.0f);
  const T side = select(r.w < T(0.0f), -one, one);
  const T square = (r.x * r.x + r.y * r.y) + r.z * r.z;
  // For small s = |vec r|, 2 atan2(s, w) = 2 s up to s^3.
  const auto small = square < T(1e-8f);
  const T s = sqrt(select(small, one, square));
  const T scale = side * select(small, two, (two * atan2(s, r.w * side)) / s);
  return {r.x * scale, r.y * scale, r.z * scale};
}

constexpr float kAngularDamping = 0.01f;  // times c

// Returns the moment on the parent for two or three perpendicular angular axes.
template <class T>
Vec3<T> euler_moment(const JointFrames<T>& j, const JointDof<T>* dofs, int count,
                     const JointAttach<T>& attach) {
  using namespace math;
  const Vec3<T> axes[3] = {dofs[0].axis, dofs[1].axis, dofs[count - 1].axis};
  const JointAngles<T> a = joint_angles(j.r, axes, count);
  const Vec3<T> w = rotate_inverse(j.parent.q, j.w);
  Vec3<T> moment = no_vector<T>();
  for (int k = 0; k < count; ++k) {
    const T tau = joint_dof_force(dofs[k], a.q[k], dot(a.dual[k], w));
    moment = moment + a.dual[k] * (-dofs[k].force - tau);
  }
  if (count == 2) {
    const T held = a.q[2] * attach.ke + (dot(a.dual[2], w) * attach.kd) * T(kAngularDamping);
    moment = moment + a.dual[2] * held;
  }
  return rotate(j.parent.q, moment);
}

template <class T>
Vec3<T> angular_moment(const JointFrames<T>& j, const JointDof<T>* dofs, int count,
                       const JointAttach<T>& attach) {
  using namespace math;
  const T share = T(kAngularDamping);
  if (count > 1) return euler_moment(j, dofs, count, attach);
  if (count == 0)
    return rotate(j.parent.q, rotation_vector(j.r)) * attach.ke + (j.w * attach.kd) * share;
  const Vec3<T> a_p = rotate(j.parent.q, dofs[0].axis), a_c = rotate(j.child.q, dofs[0].axis);
  const T q = joint_angles(j.r, &dofs[0].axis, 1).q[0], qd = dot(j.w, a_p);
  const T tau = joint_dof_force(dofs[0], q, qd);
  return a_p * (-dofs[0].force - tau) +
         (cross(a_p, a_c) * attach.ke + ((j.w - a_p * qd) * attach.kd) * share);
}

template <class T>
Vec3<T> ball_moment(const JointFrames<T>& j, const JointDof<T>* dofs) {
  using namespace math;
  Vec3<T> moment = no_vector<T>();
  for (int k = 0; k < 3; ++k) {
    const Vec3<T> a = rotate(j.parent.q, dofs[k].axis);
    moment = moment + a * (-dofs[k].force + dofs[k].damping * dot(a, j.w));
  }
  return moment;
}

template <class T>
JointWrench<T> wrench_at(const Vec3<T>& arm_p, const Vec3<T>& arm_c, const Vec3<T>& f,
                         const Vec3<T>& t) {
  return {{f, t + math::cross(arm_p, f)}, {-f, -(t + math::cross(arm_c, f))}};
}

}  // namespace joint_detail

// Returns the wrench of a joint of any type except FREE and DISTANCE. `dofs` has the `linear` axes
// first, then the `angular` axes (three if `is_ball`).
template <class T>
JointWrench<T> penalty_joint_wrench(const JointFrames<T>& j, const JointDof<T>* dofs, int linear,
                                    int angular, bool is_ball, const JointAttach<T>& attach) {
  using namespace math;
  Vec3<T> axis[3], slot = joint_detail::no_vector<T>();
  T q[3];
  for (int i = 0; i < linear; ++i) {
    axis[i] = rotate(j.parent.q, dofs[i].axis);
    q[i] = dot(j.x, axis[i]);
    slot = slot + axis[i] * q[i];
  }
  Vec3<T> f = joint_detail::no_vector<T>(), x = j.x, v = j.v, arm_p = j.arm_p;
  if (linear > 0) {
    v = v - cross(j.w_p, slot);
    arm_p = arm_p + slot;
    x = x - slot;
  }
  const Vec3<T> rate = v;
  for (int i = 0; i < linear; ++i) {
    const T qd = dot(rate, axis[i]);
    f = f + axis[i] * (-dofs[i].force - joint_dof_force(dofs[i], q[i], qd));
    v = v - axis[i] * qd;
  }
  f = f + (x * attach.ke + v * attach.kd);
  const Vec3<T> t = is_ball ? joint_detail::ball_moment(j, dofs + linear)
                            : joint_detail::angular_moment(j, dofs + linear, angular, attach);
  return joint_detail::wrench_at(arm_p, j.arm_c, f, t);
}

// Returns the wrench of a DISTANCE joint. `limits`: those of its first degree of freedom.
template <class T>
JointWrench<T> distance_joint_wrench(const JointFrames<T>& j, const JointLimit<T>& limits) {
  using namespace math;
  const T zero = T(0.0f), square = dot(j.x, j.x);
  const auto apart = square > zero;
  const T l = select(apart, sqrt(select(apart, square, T(1.0f))), zero);
  const Vec3<T> u = j.x * select(apart, T(1.0f) / select(apart, l, T(1.0f)), zero);
  const T force = distance_force(limits, l, dot(u, j.v));
  return joint_detail::wrench_at(j.arm_p, j.arm_c, u * force, Vec3<T>{zero, zero, zero});
}

}  // namespace novaphy
