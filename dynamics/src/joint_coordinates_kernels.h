// eval_fk, a row per articulation: articulation/kinematics.h over the arrays of models and states,
// so that bodies are where a step of articulations would have them, to the bit.
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

}  // namespace novaphy
