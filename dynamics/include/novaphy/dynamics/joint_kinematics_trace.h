// Joint coordinates from the pose and motion of the child body. The inverse, poses from
// coordinates, is in articulation/kinematics.h.
//
// Symbols, in the world frame unless stated otherwise:
//   X_p, X_c     pose of the joint frame in the parent body and in the child body
//   J(q)         pose of the child's joint frame in the parent's joint frame:
//     linear axes a_i     translation by the sum of a_i q_i
//     angular axes        then R(a_0, q_0) R(a_1, q_1) R(a_2, q_2): each axis rotates with the
//                         axes before it
//     BALL, FREE          a quaternion; FREE: also a translation
//   qd           rates of q. BALL: angular velocity of the child relative to the parent.
//                FREE: velocity of the center of mass, then angular velocity, relative to the
//                parent
//   twists       (velocity of the center of mass, angular velocity), m/s, rad/s
// Law: X_child = X_parent X_p J(q) X_c^-1. The functions here solve it for q. A single angle is in
// [-pi, pi]. With two or three perpendicular axes the second angle is in [-pi/2, pi/2]. At the ends
// of that interval the axes lie in a plane (gimbal lock), and the rates use a determinant of 1e-4
// instead of 0.
// Source: Featherstone, Rigid Body Dynamics Algorithms (2008), section 4.4; coordinates of Newton
// 1.8.0.
//
// Freestanding: templates over the scalar. No gradient is used. The formulas are smooth except
// where angles jump or the axes lie in a plane.
#pragma once

#include "novaphy/math/functions.h"
#include "novaphy/math/spatial.h"
#include "novaphy/math/types.h"

namespace novaphy {

// The axes of a joint that is not FREE: first `linear` axes, then `angular` axes. Unit vectors in
// the joint frame of the parent.
template <class T>
struct JointAxes {
  const Vec3<T>* axis = nullptr;
  int linear = 0, angular = 0;
  bool is_ball = false;  // one quaternion replaces the three angular coordinates
};

template <class T>
struct JointMotion {
  Transform<T> pose = Transform<T>::identity();  // J(q)
  // Velocity of the child's joint frame relative to the parent's, at the origin of the child's
  // joint frame, in the axes of the parent's joint frame.
  SpatialVector<T> rate{};
};

// The angles of a rotation about perpendicular axes, and the dual basis of the rotated axes.
// dual[i] . w is the rate of angle i at the angular velocity w. For two axes a third perpendicular
// axis is added, whose angle takes the remaining rotation.
template <class T>
struct JointAngles {
  T q[3]{};
  Vec3<T> dual[3]{};
};
template <class T>
JointAngles<T> joint_angles(const Quat<T>& r, const Vec3<T>* axis, int count) {
  using namespace math;
  JointAngles<T> a;
  if (count == 1) {
    const T side = select(r.w < T(0.0f), T(-1.0f), T(1.0f));
    a.q[0] = T(2.0f) * atan2(dot(axis[0], Vec3<T>{r.x, r.y, r.z}) * side, r.w * side);
    a.dual[0] = axis[0];
    return a;
  }
  const Vec3<T> a0 = axis[0], a1 = axis[1], a2 = cross(a0, a1);
  const Vec3<T> r0 = rotate(r, a0), r1 = rotate(r, a1), r2 = rotate(r, a2);
  const T m00 = dot(a0, r0), m01 = dot(a0, r1);
  const T cosine = sqrt(max(m00 * m00 + m01 * m01, T(1e-8f)));
  a.q[0] = atan2(-dot(a1, r2), dot(a2, r2));
  a.q[1] = atan2(dot(a0, r2), cosine);
  a.q[2] = atan2(-m01, m00);
  const Vec3<T> e1 = a1 * cos(a.q[0]) + a2 * sin(a.q[0]);
  const Vec3<T> n = cross(e1, r2);
  const T det = dot(a0, n), small = T(1e-4f);
  const T inverse = T(1.0f) / select(det < T(0.0f), min(det, -small), max(det, small));
  a.dual[0] = n * inverse;
  a.dual[1] = cross(r2, a0) * inverse;
  a.dual[2] = cross(a0, e1) * inverse;
  // The given third axis may be a2 or -a2.
  const T side = count == 3 ? select(dot(axis[2], a2) < T(0.0f), T(-1.0f), T(1.0f)) : T(1.0f);
  a.q[2] = a.q[2] * side;
  a.dual[2] = a.dual[2] * side;
  return a;
}

// Computes the coordinates q and rates qd of a relative motion. The angular axes are perpendicular
// to each other, and so are the linear axes.
template <class T>
void joint_coordinates(const JointAxes<T>& joint, const JointMotion<T>& motion, T* q, T* qd) {
  using namespace math;
  for (int i = 0; i < joint.linear; ++i) {
    q[i] = dot(joint.axis[i], motion.pose.p);
    qd[i] = dot(joint.axis[i], motion.rate.linear);
  }
  T *angle = q + joint.linear, *speed = qd + joint.linear;
  const Vec3<T>& w = motion.rate.angular;
  if (joint.is_ball) {
    const Quat<T>& r = motion.pose.q;
    angle[0] = r.x;
    angle[1] = r.y;
    angle[2] = r.z;
    angle[3] = r.w;
    speed[0] = w.x;
    speed[1] = w.y;
    speed[2] = w.z;
  } else if (joint.angular > 0) {
    const JointAngles<T> a = joint_angles(motion.pose.q, joint.axis + joint.linear, joint.angular);
    for (int i = 0; i < joint.angular; ++i) {
      angle[i] = a.q[i];
      speed[i] = dot(a.dual[i], w);
    }
  }
}

}  // namespace novaphy
