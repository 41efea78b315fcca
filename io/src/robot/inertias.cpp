// Inertias of links, and corrections of inertias that are missing or not physical.
#include <algorithm>
#include <numbers>

#include "robot.h"

namespace novaphy::detail {

namespace {

constexpr float kLeastArmature = 1e-3f;

}  // namespace

Mat33d from_axes(const PrincipalAxes& axes) {
  Mat33d result{};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j)
      for (int k = 0; k < 3; ++k)
        result.m[i][j] += axes.axes[i][k] * axes.moments[k] * axes.axes[j][k];
  return result;
}

bool has_extent(const Mat33d& inertia) {
  const bool is_diagonal =
      inertia.m[0][1] == 0.0 && inertia.m[0][2] == 0.0 && inertia.m[1][2] == 0.0;
  const PrincipalAxes p = principal_axes(inertia);
  const auto [least, largest] = std::minmax({p.moments[0], p.moments[1], p.moments[2]});
  return static_cast<float>(least) > 0.0f && (is_diagonal || least > 2e-7 * largest);
}

void mend_inertias(Robot& robot, bool moving,
                   const std::function<void(size_t, const std::string&)>& mended) {
  std::vector<const RobotJoint*> joints;
  std::vector<const RobotJoint*> mover(robot.links.size(), nullptr);
  for (const RobotJoint& joint : robot.joints) {
    joints.push_back(&joint);
    mover[static_cast<size_t>(joint.child)] = &joint;
  }
  std::map<const RobotJoint*, int> depth;
  for (const RobotJoint* joint : joints)
    for (const RobotJoint* at = joint; at->parent >= 0; at = mover[static_cast<size_t>(at->parent)])
      ++depth[joint];
  std::stable_sort(joints.begin(), joints.end(),
                   [&](const auto* a, const auto* b) { return depth[a] > depth[b]; });
  const auto is_zero = [](const Mat33d& m) {
    return std::all_of(&m.m[0][0], &m.m[0][0] + 9, [](double v) { return v == 0.0; });
  };
  for (const RobotJoint* joint : joints) {  // children come before their parents
    RobotLink& link = robot.links[static_cast<size_t>(joint->child)];
    if (link.is_kinematic || (link.mass == 0.0 && is_zero(link.inertia))) continue;
    if (link.mass > 0.0 && has_extent(link.inertia)) continue;
    if (!can_move(joint->type) && (joint->parent >= 0 || !moving)) {
      if (joint->parent >= 0) {
        RobotLink& parent = robot.links[static_cast<size_t>(joint->parent)];
        const Posed pose = math::multiply(joint->parent_pose, math::inverse(joint->child_pose));
        const Mat33d inertia = turned(pose.q, link.inertia);
        if (link.mass > 0.0) {
          add_mass(parent, link.mass, math::transform_point(pose, link.com), inertia);
        } else {
          for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) parent.inertia.m[i][j] += inertia.m[i][j];
        }
      }
      link.mass = 0.0;
      link.inertia = {};
      continue;
    }
    if (!moving) continue;
    if (link.mass == 0.0) {
      link.inertia = {};
      mended(static_cast<size_t>(joint->child), "an inertia without a mass: it goes");
      continue;
    }
    const double radius = std::cbrt(3.0 * link.mass / (4000.0 * std::numbers::pi));
    PrincipalAxes p = principal_axes(link.inertia);
    for (double& moment : p.moments) moment = std::max(moment, 0.4 * link.mass * radius * radius);
    link.inertia = from_axes(p);
    mended(static_cast<size_t>(joint->child),
           "an inertia that no body has: its principal moments are at least those of a ball of "
           "water of its mass");
  }
  if (!moving) return;
  // A link whose subtree has no mass does not move under forces, so it needs no inertia.
  std::vector<double> below(robot.links.size());
  for (const RobotJoint* joint : joints) {
    const auto child = static_cast<size_t>(joint->child);
    below[child] += robot.links[child].mass;
    if (joint->parent >= 0) below[static_cast<size_t>(joint->parent)] += below[child];
  }
  for (RobotJoint& joint : robot.joints) {
    const auto child = static_cast<size_t>(joint.child);
    if (below[child] > 0.0 || !can_move(joint.type) || robot.links[child].is_kinematic) continue;
    bool changes = joint.armature == 0.0 && quaternion_at(joint.type) >= 0;
    if (changes) joint.armature = kLeastArmature;
    for (auto* axes : {&joint.linear, &joint.angular})
      for (JointDofConfig& dof : *axes) {
        changes = changes || dof.armature == 0.0f;
        if (dof.armature == 0.0f) dof.armature = kLeastArmature;
      }
    if (changes)
      mended(child, "its joint moves no mass: it gets an armature of 0.001 (kg m^2 or kg)");
  }
}

}  // namespace novaphy::detail
