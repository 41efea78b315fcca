// The joints of a step of bodies, and their multipliers, which the next step starts from.
#include <algorithm>
#include <cmath>
#include <limits>

#include "bodies_side.h"
#include "novaphy/core/sim/joint_types.h"

namespace novaphy::vbd {
namespace {

constexpr float kTurn = 6.2831853f;
constexpr float kHard = std::numeric_limits<float>::infinity();

size_t at(int32_t k) { return static_cast<size_t>(k); }

VbdBodyJointKind kind_of(JointType type) {
  switch (type) {
    case JointType::FIXED:
      return VbdBodyJointKind::Fixed;
    case JointType::REVOLUTE:
      return VbdBodyJointKind::Revolute;
    case JointType::PRISMATIC:
      return VbdBodyJointKind::Prismatic;
    case JointType::DISTANCE:
      return VbdBodyJointKind::Distance;
    case JointType::ROD:
      return VbdBodyJointKind::Rod;
    default:
      return VbdBodyJointKind::Ball;
  }
}

// Sets the penalty stiffness rho of a joint from the inverse effective masses of its bodies.
void put_metric(const BodySide& a, const BodySide& b, float dt, VbdBodyJoint& to) {
  float w = 0.0f, turning = 0.0f;
  for (const Vec3f& e : {Vec3f{1.0f, 0.0f, 0.0f}, {0.0f, 1.0f, 0.0f}, {0.0f, 0.0f, 1.0f}}) {
    w = std::max(w, a.mobility(to.arm[0], e) + b.mobility(to.arm[1], e));
    turning = std::max(turning, a.turning(e) + b.turning(e));
  }
  for (VbdJointRow& row : to.points) row = {kHard, metric(dt, w)};
  for (VbdJointRow& row : to.turns) row = {kHard, metric(dt, turning)};
  const Vec3f along = to.kind == VbdBodyJointKind::Distance ? math::normalize(to.gap) : to.axis[0];
  const float axial = to.kind == VbdBodyJointKind::Revolute
                          ? a.turning(along) + b.turning(along)
                          : a.mobility(to.arm[0], along) + b.mobility(to.arm[1], along);
  for (VbdAxisRow& row : to.rows) row.rho = metric(dt, axial);
}

// Sets the stiffness and damping of a ROD joint. `ke` and `kd` have six values. `frame`: the
// rotation of the joint frame of A.
void put_rod(const float* ke, const float* kd, float dt, const Quatf& frame, VbdBodyJoint& to) {
  to.axis[1] = math::rotate(frame, Vec3f{1.0f, 0.0f, 0.0f});
  const Vec3f axes[3] = {to.axis[1], math::cross(to.axis[0], to.axis[1]), to.axis[0]};
  const Vec3f errors[2] = {to.gap, log_rotation(to.turned)};
  to.keep = to.keep_turn = {};
  for (int k = 0; k < 6; ++k) {
    VbdJointRow& row = k < 3 ? to.points[k] : to.turns[k - 3];
    const float damping = kd[k] / dt;
    row.stiffness = ke[k] + damping;
    if (!(damping > 0.0f)) continue;
    const Vec3f& axis = axes[k % 3];
    Vec3f& keep = k < 3 ? to.keep : to.keep_turn;
    keep = keep + axis * (math::dot(axis, errors[k / 3]) * (damping / row.stiffness));
  }
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
    VbdBodyJoint j;
    j.body[0] = m.joint_parent.data()[k];
    j.body[1] = m.joint_child.data()[k];
    j.kind = kind_of(type);
    const BodySide a(m, in, is_kinematic_.data(), j.body[0]),
        b(m, in, is_kinematic_.data(), j.body[1]);
    if (!a.moves && !b.moves) continue;
    const Transformf frames[2] = {math::multiply(a.pose, m.joint_X_p.data()[k]),
                                  math::multiply(b.pose, m.joint_X_c.data()[k])};
    j.arm[0] = frames[0].p - a.center;
    j.arm[1] = frames[1].p - b.center;
    j.gap = frames[1].p - frames[0].p;
    j.keep = j.gap * kVbdKeptError;
    j.turned = math::multiply(frames[1].q, math::conjugate(frames[0].q));
    const Vec3f axis =
        has_axes(type) ? m.joint_axis.data()[m.joint_qd_start.data()[k]] : Vec3f{0.0f, 0.0f, 1.0f};
    for (int s = 0; s < 2; ++s) j.axis[s] = math::normalize(math::rotate(frames[s].q, axis));
    const float sign = j.turned.w < 0.0f ? -2.0f : 2.0f;
    j.keep_turn = j.kind == VbdBodyJointKind::Revolute
                      ? math::cross(j.axis[0], j.axis[1]) * kVbdKeptError
                      : Vec3f{j.turned.x, j.turned.y, j.turned.z} * (sign * kVbdKeptError);
    put_metric(a, b, dt_, j);
    if (memory[k].is_used != 0.0f) {
      j.lam = math::rotate(a.pose.q, memory[k].lam) * kRecall;
      j.lam_turn = math::rotate(a.pose.q, memory[k].lam_turn) * kRecall;
      for (int r = 0; r < kVbdAxisRows; ++r) j.rows[r].lam = memory[k].axis[r] * kRecall;
    }
    if (type == JointType::ROD) {
      const auto dof = m.joint_qd_start.data()[k];
      put_rod(m.joint_target_ke.data() + dof, m.joint_target_kd.data() + dof, dt_, frames[0].q, j);
    }
    put_axis(k, in, control, j);
    pairs_.push_back({a.moves ? j.body[0] : -1, b.moves ? j.body[1] : -1});
    numbers_.push_back(8 * static_cast<int32_t>(joint_.size()) + 2 * kJointRow);
    joint_.push_back(j);
    joints_.push_back(static_cast<int32_t>(k));
  }
}

// Returns the rate of the joint coordinate at the start of the step (rad/s or m/s).
float Bodies::joint_rate(const SimState& in, const VbdBodyJoint& j) const {
  const auto twist = [&](int side) {
    return j.body[side] < 0 ? SpatialVectorf{} : in.body_qd.data()[j.body[side]];
  };
  const SpatialVectorf a = twist(0), b = twist(1);
  if (j.kind == VbdBodyJointKind::Revolute) return math::dot(j.axis[0], b.angular - a.angular);
  return math::dot(j.axis[0], (b.linear + math::cross(b.angular, j.arm[1])) -
                                  (a.linear + math::cross(a.angular, j.arm[0] + j.gap)));
}

// Returns the joint coordinate at the start of the step (rad or m). An angle is the value nearest
// to the angle of the previous step.
float Bodies::joint_coordinate(size_t joint, const VbdBodyJoint& j) const {
  if (j.kind == VbdBodyJointKind::Prismatic) return math::dot(j.axis[0], j.gap);
  const Vec3f v = {j.turned.x, j.turned.y, j.turned.z};
  const float angle = 2.0f * math::atan2(math::dot(v, j.axis[0]), j.turned.w);
  const auto& before = reinterpret_cast<const JointMemory*>(memory_.data() + joints_at())[joint];
  const float last = before.is_used != 0.0f
                         ? before.coordinate
                         : model_.joint_q.data()[model_.joint_q_start.data()[joint]];
  return angle + kTurn * std::round((last - angle) / kTurn);
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
