// Kernels of the functions of joint coordinates (joint_coordinates.h).
//
//   eval_fk_articulation  a row per articulation: articulation/kinematics.h over the arrays of
//                         models and states, with the bits of a step of articulations
//   eval_ik_joint         a row per joint: joint_kinematics_trace.h
//   eval_mimic_joint      a row per joint: q0 = coef0 + coef1 q1
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/dynamics/articulation/joint_links.h"
#include "novaphy/dynamics/articulation/kinematics.h"
#include "novaphy/dynamics/joint_kinematics_trace.h"

namespace novaphy {

// The joint arrays of a model.
struct JointArrays {
  NOVAPHY_ARGUMENTS(Reads<int32_t> joint_type, joint_parent, joint_child, joint_q_start,
                    joint_qd_start;
                    Reads<Vec2i> joint_dof_dim; Reads<Transformf> joint_X_p, joint_X_c;
                    Reads<Vec3f> joint_axis; Reads<Vec3f> body_com;)

  JointType type(int32_t j) const { return static_cast<JointType>(joint_type[j]); }
  JointAxes<float> axes(int32_t j) const {
    return {joint_axis + joint_qd_start[j], joint_dof_dim[j].x, joint_dof_dim[j].y,
            quaternion_at(type(j)) == 0};
  }
  articulation::JointRows rows(int32_t j) const {
    return {type(j),           j,
            joint_child[j],    joint_q_start[j],
            joint_qd_start[j], joint_qd_start[j + 1] - joint_qd_start[j],
            joint_dof_dim[j].x};
  }
};

struct BodyFrame {
  Transformf pose = Transformf::identity();
  SpatialVectorf twist{};  // velocity at the point `com`
  Vec3f com{};             // in the world frame
  Vec3f velocity(const Vec3f& point) const {
    return twist.linear + math::cross(twist.angular, point - com);
  }
};
inline BodyFrame body_frame(const JointArrays& joints, const Transformf* q,
                            const SpatialVectorf* qd, int32_t body) {
  if (body < 0) return {};
  return {q[body], qd[body], math::transform_point(q[body], joints.body_com[body])};
}

// The position, and the origin of the tree, of a body's link. body_q has the remaining data.
struct BodyPlace {
  Vec3f p, origin;
  SpatialVectorf v;
};

struct EvalFkArguments {
  NOVAPHY_ARGUMENTS(Part<JointArrays> joints; ReadsRow<int32_t> articulation_start,
                                              // first and last joint of each articulation
                                              articulation_end;
                    Reads<float> joint_q, joint_qd; Detached<Updates<Transformf>> body_q;
                    Detached<Updates<SpatialVectorf>> body_qd;
                    Writes<BodyPlace> places;  // {bodies}
  )
};
NOVAPHY_ROW_KERNEL(eval_fk_articulation, EvalFkArguments) {
  const JointArrays& joints = a.joints;
  const float* const q = a.joint_q;
  Transformf* const body_q = a.body_q;
  SpatialVectorf* const body_qd = a.body_qd;
  articulation::Tree<float> tree;
  tree.X_p = joints.joint_X_p;
  tree.X_c = joints.joint_X_c;
  tree.axis = joints.joint_axis;
  tree.com = joints.body_com;
  articulation::LinkState<float> links[2];  // the current link and its predecessor
  for (int32_t j = a.articulation_start[row]; j < a.articulation_end[row]; ++j) {
    const articulation::JointRows joint = joints.rows(j);
    tree.first_dof = joint.dof;
    articulation::LinkState<float>* last = nullptr;
    if (joints.joint_parent[j] >= 0) {
      const BodyPlace& place = a.places[joints.joint_parent[j]];
      last = &links[1];
      last->q = body_q[joints.joint_parent[j]].q;
      last->p = place.p;
      last->origin = place.origin;
      last->v = place.v;
    }
    SpatialVectorf axes[6];
    for (int32_t k = 0; k < articulation::link_count(joint); ++k) {
      const articulation::Link link = articulation::joint_link(joint, k, last == nullptr ? -1 : 0);
      articulation::LinkState<float>& s = links[k % 2];
      articulation::link_frame(tree, link, last, q, s);
      articulation::set_axes(tree, link, s, axes);
      const SpatialVectorf v = articulation::joint_motion(tree, link, axes, a.joint_qd + joint.dof);
      s.v = last == nullptr ? v : last->v + v;
      last = &s;
    }
    a.places[joint.child] = {last->p, last->origin, last->v};
    articulation::write_body(joint.child, *last, body_q, body_qd);
  }
}

struct EvalIkArguments {
  NOVAPHY_ARGUMENTS(Part<JointArrays> joints; Reads<Transformf> body_q;
                    Reads<SpatialVectorf> body_qd; Writes<float> joint_q, joint_qd;)
};
NOVAPHY_ROW_KERNEL(eval_ik_joint, EvalIkArguments) {
  const JointArrays& joints = a.joints;
  const int32_t j = static_cast<int32_t>(row);
  float *const c = a.joint_q + joints.joint_q_start[j], *const rate =
                                                            a.joint_qd + joints.joint_qd_start[j];
  const BodyFrame parent = body_frame(joints, a.body_q, a.body_qd, joints.joint_parent[j]);
  const BodyFrame child = body_frame(joints, a.body_q, a.body_qd, joints.joint_child[j]);
  const Transformf anchor = math::multiply(parent.pose, joints.joint_X_p[j]);
  const Transformf at = math::multiply(child.pose, joints.joint_X_c[j]);
  JointMotion<float> motion;
  motion.pose = {math::rotate_inverse(anchor.q, at.p - anchor.p),
                 math::multiply(math::conjugate(anchor.q), at.q)};
  const bool is_pose = has_pose(joints.type(j));
  const Vec3f point = is_pose ? child.com : at.p;
  motion.rate = {math::rotate_inverse(anchor.q, child.velocity(point) - parent.velocity(point)),
                 math::rotate_inverse(anchor.q, child.twist.angular - parent.twist.angular)};
  if (!is_pose) return joint_coordinates(joints.axes(j), motion, c, rate);
  const Transformf& x = motion.pose;
  const float pose[] = {x.p.x, x.p.y, x.p.z, x.q.x, x.q.y, x.q.z, x.q.w};
  const Vec3f &v = motion.rate.linear, &w = motion.rate.angular;
  const float twist[] = {v.x, v.y, v.z, w.x, w.y, w.z};
  for (int k = 0; k < 7; ++k) c[k] = pose[k];
  for (int k = 0; k < 6; ++k) rate[k] = twist[k];
}

struct EvalMimicArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> joint_mimic, joint_q_start, joint_qd_start;
                    Reads<Vec2f> joint_mimic_coef; Updates<float> joint_q, joint_qd;)
};
// A mimic joint reads the joint at the end of its chain of leaders, because no kernel row writes
// that joint. The relation (multiplier and offset) is that of Articulations.
NOVAPHY_ROW_KERNEL(eval_mimic_joint, EvalMimicArguments) {
  const int32_t joint = static_cast<int32_t>(row);
  int32_t leader = joint;
  float offset = 0.0f, multiplier = 1.0f;
  for (; a.joint_mimic[leader] >= 0; leader = a.joint_mimic[leader]) {
    offset += multiplier * a.joint_mimic_coef[leader].x;
    multiplier *= a.joint_mimic_coef[leader].y;
  }
  if (leader == joint) return;
  a.joint_q[a.joint_q_start[joint]] = multiplier * a.joint_q[a.joint_q_start[leader]] + offset;
  a.joint_qd[a.joint_qd_start[joint]] = multiplier * a.joint_qd[a.joint_qd_start[leader]];
}

}  // namespace novaphy
