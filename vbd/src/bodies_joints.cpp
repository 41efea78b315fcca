// The joints of a step of bodies, and their multipliers, which the next step starts from.
#include <algorithm>
#include <cmath>

#include "bodies_side.h"
#include "novaphy/core/sim/joint_types.h"

namespace novaphy::vbd {
namespace {

constexpr float kTurn = 6.2831853f;  // rad

size_t at(int32_t k) { return static_cast<size_t>(k); }

// Sets the penalty stiffness rho of a joint from the inverse effective masses of its bodies.
void put_metric(const BodySide& a, const BodySide& b, float dt, VbdBodyJoint& to) {
  float w = 0.0f, turning = 0.0f;
  for (const Vec3f& e : {Vec3f{1.0f, 0.0f, 0.0f}, {0.0f, 1.0f, 0.0f}, {0.0f, 0.0f, 1.0f}}) {
    w = std::max(w, a.mobility(to.arm[0], e) + b.mobility(to.arm[1], e));
    turning = std::max(turning, a.turning(e) + b.turning(e));
  }
  for (VbdJointRow& row : to.points) row.rho = metric(dt, w);
  for (VbdJointRow& row : to.turns) row.rho = metric(dt, turning);
  const Vec3f along = to.kind == VbdBodyJointKind::Distance ? math::normalize(to.gap) : to.axis[0];
  const float axial = to.kind == VbdBodyJointKind::Revolute
                          ? a.turning(along) + b.turning(along)
                          : a.mobility(to.arm[0], along) + b.mobility(to.arm[1], along);
  for (VbdAxisRow& row : to.rows) row.rho = metric(dt, axial);
}

}  // namespace

void Bodies::put_joints(const SimState& in, const Control* control) {
  const Model& m = model_;
  const auto* const memory = memory_at<JointMemory>(joints_at());
  joint_.clear();
  joints_.clear();
  for (size_t k = 0; k < joint_count_; ++k) {
    const auto type = static_cast<JointType>(m.joint_type.data()[k]);
    if (type == JointType::FREE || m.joint_enabled.data()[k] == 0) continue;
    const int32_t bodies[2] = {m.joint_parent.data()[k], m.joint_child.data()[k]};
    const BodySide a(m, in, is_kinematic_.data(), bodies[0]),
        b(m, in, is_kinematic_.data(), bodies[1]);
    if (!a.moves && !b.moves) continue;
    const JointStart<float> start =
        joint_start(m, in.body_q.data(), in.body_qd.data(), control, k);
    VbdBodyJoint j = joint_geometry(start);
    for (int s = 0; s < 2; ++s) j.body[s] = bodies[s];
    put_metric(a, b, dt_, j);
    if (memory[k].is_used != 0.0f) {
      j.lam = math::rotate(a.pose.q, memory[k].lam) * kRecall;
      j.lam_turn = math::rotate(a.pose.q, memory[k].lam_turn) * kRecall;
      for (int r = 0; r < kVbdAxisRows; ++r) j.rows[r].lam = memory[k].axis[r] * kRecall;
    }
    if (has_coordinate(j.kind)) j.coordinate = nearest_coordinate(k, j);
    put_rows(start, dt_, j);
    for (VbdAxisRow& row : j.rows)
      if (row.stiffness != 0.0f) row.lam = std::clamp(row.lam, row.lower, row.upper);
    pairs_.push_back({a.moves ? j.body[0] : -1, b.moves ? j.body[1] : -1});
    numbers_.push_back(8 * static_cast<int32_t>(joint_.size()) + 2 * kJointRow);
    joint_.push_back(j);
    joints_.push_back(static_cast<int32_t>(k));
  }
}

// Returns the joint coordinate at the start of the step (rad or m). An angle is the value nearest
// to the angle of the previous step.
float Bodies::nearest_coordinate(size_t joint, const VbdBodyJoint& j) const {
  const float q = joint_coordinate(j);
  if (j.kind == VbdBodyJointKind::Prismatic) return q;
  const auto& before = reinterpret_cast<const JointMemory*>(memory_.data() + joints_at())[joint];
  const float last = before.is_used != 0.0f
                         ? before.coordinate
                         : model_.joint_q.data()[model_.joint_q_start.data()[joint]];
  return q + kTurn * std::round((last - q) / kTurn);
}

std::vector<SpatialVectorf> Bodies::joint_forces() const {
  std::vector<SpatialVectorf> forces(joint_count_);
  for (size_t k = 0; k < joint_.size(); ++k) {
    const VbdBodyJoint& j = joint_[k];
    const JointErrors e =
        joint_errors(j, motion_of(motion_.data(), j.body[0]), motion_of(motion_.data(), j.body[1]));
    float along = j.force;
    for (const VbdAxisRow& row : j.rows)
      if (row.stiffness != 0.0f) along += row.lam;
    SpatialVectorf& f = forces[at(joints_[k])];
    f = {-j.lam, -joint_moment(j, e, j.lam_turn)};
    Vec3f& part = j.kind == VbdBodyJointKind::Revolute ? f.angular : f.linear;
    part = part + e.axis * along;
  }
  return forces;
}

void Bodies::keep_joints(const SimState& in) {
  auto* const memory = memory_at<JointMemory>(joints_at());
  for (size_t k = 0; k < joint_count_; ++k) memory[k].is_used = 0.0f;
  for (size_t k = 0; k < joint_.size(); ++k) {
    const VbdBodyJoint& j = joint_[k];
    const Quatf q = j.body[0] < 0 ? Quatf::identity() : in.body_q.data()[j.body[0]].q;
    const Quatf turned = j.body[0] < 0 ? q : math::multiply(motion_[at(j.body[0])].turned, q);
    const VbdBodyMotion a = motion_of(motion_.data(), j.body[0]);
    JointMemory& to = memory[at(joints_[k])];
    to.lam = math::rotate_inverse(turned, j.lam);
    to.lam_turn = math::rotate_inverse(turned, j.lam_turn);
    to.coordinate = joint_errors(j, a, motion_of(motion_.data(), j.body[1])).coordinate;
    to.is_used = 1.0f;
    for (int r = 0; r < kVbdAxisRows; ++r) to.axis[r] = j.rows[r].lam;
  }
}

}  // namespace novaphy::vbd
