// eval_fk, a row per articulation: articulation/kinematics.h over the arrays of models and states,
// so that bodies are where a step of articulations would have them, to the bit. eval_ik, a row per
// joint: joint_kinematics_trace.h. eval_mimic, a row per joint: q0 = coef0 + coef1 q1.
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/dynamics/articulation/joint_links.h"
#include "novaphy/dynamics/articulation/kinematics.h"
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
  articulation::JointRows rows(int32_t j) const {
    return {static_cast<JointType>(type[j]), j,        child[j], q_start[j], qd_start[j],
            qd_start[j + 1] - qd_start[j],   dims[j].x};
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

// What a body's links have, besides body_q.
struct BodyPlace {
  Vec3f p, origin;
  SpatialVectorf v;
};

struct EvalFkArguments {
  JointArrays joints;
  const int32_t *begin, *end;  // joints of the articulations
  const float *q, *qd;
  Transformf* body_q;
  SpatialVectorf* body_qd;
  BodyPlace* places;  // {bodies}
};
NOVAPHY_ROW_KERNEL(eval_fk_articulation, 17, EvalFkArguments) {
  const JointArrays& joints = a.joints;
  articulation::Tree<float> tree;
  tree.X_p = joints.x_p;
  tree.X_c = joints.x_c;
  tree.axis = joints.axis;
  tree.com = joints.com;
  articulation::LinkState<float> links[2];  // a link and the one before it
  for (int32_t j = a.begin[row]; j < a.end[row]; ++j) {
    const articulation::JointRows joint = joints.rows(j);
    tree.first_dof = joint.dof;
    articulation::LinkState<float>* last = nullptr;
    if (joints.parent[j] >= 0) {
      const BodyPlace& place = a.places[joints.parent[j]];
      last = &links[1];
      last->q = a.body_q[joints.parent[j]].q;
      last->p = place.p;
      last->origin = place.origin;
      last->v = place.v;
    }
    SpatialVectorf axes[6];
    for (int32_t k = 0; k < articulation::link_count(joint); ++k) {
      const articulation::Link link = articulation::joint_link(joint, k, last == nullptr ? -1 : 0);
      articulation::LinkState<float>& s = links[k % 2];
      articulation::link_frame(tree, link, last, a.q, s);
      articulation::set_axes(tree, link, s, axes);
      const SpatialVectorf v = articulation::joint_motion(tree, link, axes, a.qd + joint.dof);
      s.v = last == nullptr ? v : last->v + v;
      last = &s;
    }
    a.places[joint.child] = {last->p, last->origin, last->v};
    articulation::write_body(joint.child, *last, a.body_q, a.body_qd);
  }
}

struct EvalIkArguments {
  JointArrays joints;
  const Transformf* body_q;
  const SpatialVectorf* body_qd;
  float *q, *qd;
};
NOVAPHY_ROW_KERNEL(eval_ik_joint, 14, EvalIkArguments) {
  const JointArrays& joints = a.joints;
  const int32_t j = static_cast<int32_t>(row);
  float *const c = a.q + joints.q_start[j], *const rate = a.qd + joints.qd_start[j];
  const BodyFrame parent = body_frame(joints, a.body_q, a.body_qd, joints.parent[j]);
  const BodyFrame child = body_frame(joints, a.body_q, a.body_qd, joints.child[j]);
  const Transformf anchor = math::multiply(parent.pose, joints.x_p[j]);
  const Transformf at = math::multiply(child.pose, joints.x_c[j]);
  JointMotion<float> motion;
  motion.pose = {math::rotate_inverse(anchor.q, at.p - anchor.p),
                 math::multiply(math::conjugate(anchor.q), at.q)};
  const Vec3f point = joints.is_six(j) ? child.com : at.p;
  motion.rate = {math::rotate_inverse(anchor.q, child.velocity(point) - parent.velocity(point)),
                 math::rotate_inverse(anchor.q, child.twist.angular - parent.twist.angular)};
  if (!joints.is_six(j)) return joint_coordinates(joints.axes(j), motion, c, rate);
  const Transformf& x = motion.pose;
  const float pose[] = {x.p.x, x.p.y, x.p.z, x.q.x, x.q.y, x.q.z, x.q.w};
  const Vec3f &v = motion.rate.linear, &w = motion.rate.angular;
  const float twist[] = {v.x, v.y, v.z, w.x, w.y, w.z};
  for (int k = 0; k < 7; ++k) c[k] = pose[k];
  for (int k = 0; k < 6; ++k) rate[k] = twist[k];
}

struct EvalMimicArguments {
  const int32_t *leader, *q_start, *qd_start;
  const Vec2f* coefs;
  float *q, *qd;
};
// A follower takes the joint that its leaders follow in the end, which nobody writes; by the
// numbers of Articulations.
NOVAPHY_ROW_KERNEL(eval_mimic_joint, 6, EvalMimicArguments) {
  const int32_t joint = static_cast<int32_t>(row);
  int32_t leader = joint;
  float offset = 0.0f, multiplier = 1.0f;
  for (; a.leader[leader] >= 0; leader = a.leader[leader]) {
    offset += multiplier * a.coefs[leader].x;
    multiplier *= a.coefs[leader].y;
  }
  if (leader == joint) return;
  a.q[a.q_start[joint]] = multiplier * a.q[a.q_start[leader]] + offset;
  a.qd[a.qd_start[joint]] = multiplier * a.qd[a.qd_start[leader]];
}

}  // namespace novaphy
