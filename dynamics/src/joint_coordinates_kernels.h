// eval_fk, a row per articulation: joint_kinematics_trace.h over the arrays of models and states.
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/dynamics/joint_kinematics_trace.h"

namespace novaphy {

// The joints of a model.
struct JointArrays {
  const int32_t *type, *parent, *child, *q_start, *qd_start;
  const Vec2i* dims;
  const Transformf *x_p, *x_c;
  const Vec3f* axis;
  const Vec3f* com;  // of the bodies

  bool is(int32_t j, JointType wanted) const { return type[j] == static_cast<int32_t>(wanted); }
  bool is_six(int32_t j) const { return is(j, JointType::FREE) || is(j, JointType::DISTANCE); }
  JointAxes<float> axes(int32_t j) const {
    return {axis + qd_start[j], dims[j].x, dims[j].y, is(j, JointType::BALL)};
  }
};

struct BodyFrame {
  Transformf pose = Transformf::identity();
  SpatialVectorf twist{};  // of the point `com`
  Vec3f com{};             // world
  Vec3f velocity(const Vec3f& point) const {
    return twist.linear + math::cross(twist.angular, point - com);
  }
};
inline BodyFrame body_frame(const JointArrays& joints, const Transformf* q,
                            const SpatialVectorf* qd, int32_t body) {
  if (body < 0) return {};
  return {q[body], qd[body], math::transform_point(q[body], joints.com[body])};
}

inline float square_length(const Quatf& q) {
  return ((q.x * q.x + q.y * q.y) + q.z * q.z) + q.w * q.w;
}
// A unit quaternion keeps its bits; one of length 0 becomes NaN.
inline Quatf unit_quat(const Quatf& q) {
  const float square = square_length(q);
  if (math::abs(square - 1.0f) <= 0x1p-22f) return q;
  const float scale = 1.0f / math::sqrt(square);
  return {q.x * scale, q.y * scale, q.z * scale, q.w * scale};
}

struct EvalFkArguments {
  JointArrays joints;
  const int32_t *begin, *end;  // joints of the articulations
  const float *q, *qd;
  Transformf* body_q;
  SpatialVectorf* body_qd;
};
NOVAPHY_ROW_KERNEL(eval_fk_articulation, 16, EvalFkArguments) {
  const JointArrays& joints = a.joints;
  for (int32_t j = a.begin[row]; j < a.end[row]; ++j) {
    const float *const c = a.q + joints.q_start[j], *const rate = a.qd + joints.qd_start[j];
    const BodyFrame parent = body_frame(joints, a.body_q, a.body_qd, joints.parent[j]);
    const Transformf anchor = math::multiply(parent.pose, joints.x_p[j]);
    JointMotion<float> motion;
    if (joints.is_six(j)) {
      motion.pose = {{c[0], c[1], c[2]}, unit_quat({c[3], c[4], c[5], c[6]})};
      motion.rate = {{rate[0], rate[1], rate[2]}, {rate[3], rate[4], rate[5]}};
    } else {
      motion = joint_motion(joints.axes(j), c, rate);
      if (joints.is(j, JointType::BALL)) motion.pose.q = unit_quat(motion.pose.q);
    }
    const int32_t child = joints.child[j];
    const Transformf at = math::multiply(anchor, motion.pose);
    const Transformf pose = math::multiply(at, math::inverse(joints.x_c[j]));
    const Vec3f com = math::transform_point(pose, joints.com[child]);
    const Vec3f w = math::rotate(anchor.q, motion.rate.angular);
    // The rate is that of the centre of mass for FREE, of the joint frame's origin for the others.
    const Vec3f arm = joints.is_six(j) ? Vec3f{} : com - at.p;
    const Vec3f v = math::rotate(anchor.q, motion.rate.linear) + math::cross(w, arm);
    a.body_q[child] = pose;
    a.body_qd[child] = {parent.velocity(com) + v, parent.twist.angular + w};
  }
}

}  // namespace novaphy
