#include "mjcf_start.h"

#include <cmath>

namespace novaphy::detail {
namespace {

// A motion of unit rate; `linear` is that of the point at the origin.
struct Screw {
  Vec3d angular{}, linear{};
};

// Of all that moves with a link, about the origin.
struct Inertia {
  double mass = 0.0;
  Vec3d moment{};  // mass times the centre
  Mat33d about{};

  Screw momentum(const Screw& s) const {
    Vec3d l = math::cross(moment, s.linear);
    l.x += about.m[0][0] * s.angular.x + about.m[0][1] * s.angular.y + about.m[0][2] * s.angular.z;
    l.y += about.m[1][0] * s.angular.x + about.m[1][1] * s.angular.y + about.m[1][2] * s.angular.z;
    l.z += about.m[2][0] * s.angular.x + about.m[2][1] * s.angular.y + about.m[2][2] * s.angular.z;
    return {l, s.linear * mass + math::cross(s.angular, moment)};
  }
  void add(const Inertia& other) {
    mass += other.mass;
    moment = moment + other.moment;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j) about.m[i][j] += other.about.m[i][j];
  }
};

Inertia inertia_of(const RobotLink& link, const Posed& pose) {
  const Vec3d c = math::transform_point(pose, link.com);
  const double xx = c.x * c.x, yy = c.y * c.y, zz = c.z * c.z;
  Inertia result{link.mass, c * link.mass, turned(pose.q, link.inertia)};
  const double add[3][3] = {{yy + zz, -c.x * c.y, -c.x * c.z},
                            {-c.x * c.y, xx + zz, -c.y * c.z},
                            {-c.x * c.z, -c.y * c.z, xx + yy}};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) result.about.m[i][j] += link.mass * add[i][j];
  return result;
}

constexpr Vec3d kAxes[] = {{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {0.0, 0.0, 1.0}};

struct Dof {
  size_t joint, place;  // among those of the joint
  Screw screw;
  double armature;
  int32_t parent;  // the dof before it on the way to the root; -1: none
};

}  // namespace

std::vector<std::vector<double>> free_inertias(const Robot& robot) {
  const size_t links = robot.links.size();
  std::vector<Posed> pose(links, identity_pose());
  std::vector<Inertia> sum(links);
  std::vector<int32_t> last(links, -1);  // dof of each link
  std::vector<Dof> dofs;
  std::vector<std::vector<double>> result(robot.joints.size());
  for (size_t j = 0; j < robot.joints.size(); ++j) {
    const RobotJoint& joint = robot.joints[j];
    const auto child = static_cast<size_t>(joint.child);
    const Posed parent =
        joint.parent < 0 ? identity_pose() : pose[static_cast<size_t>(joint.parent)];
    const Posed frame = math::multiply(parent, joint.parent_pose);
    pose[child] =
        math::multiply(math::multiply(frame, start_pose(joint)), math::inverse(joint.child_pose));
    sum[child] = inertia_of(robot.links[child], pose[child]);
    int32_t before = joint.parent < 0 ? -1 : last[static_cast<size_t>(joint.parent)];
    const Vec3d anchor = math::transform_point(pose[child], joint.child_pose.p);
    const auto add = [&](const Vec3d& axis, bool turns, double armature) {
      dofs.push_back({j, result[j].size(),
                      turns ? Screw{axis, math::cross(anchor, axis)} : Screw{{}, axis}, armature,
                      before});
      before = static_cast<int32_t>(dofs.size()) - 1;
      result[j].push_back(0.0);
    };
    const bool is_free = joint.type == JointType::FREE && !robot.links[child].is_kinematic;
    if (is_free)
      for (const Vec3d& axis : kAxes) add(axis, false, joint.armature);
    if (is_free || joint.type == JointType::BALL)
      for (const Vec3d& axis : kAxes) add(axis, true, joint.armature);
    // Angles before that of an axis are 0, but for a ref, with which a hinge is alone.
    for (const auto* axes : {&joint.linear, &joint.angular})
      for (const JointDofConfig& dof : *axes)
        add(math::rotate(frame.q, Vec3d{dof.axis.x, dof.axis.y, dof.axis.z}),
            axes == &joint.angular, dof.armature);
    last[child] = before;
  }
  for (size_t j = robot.joints.size(); j-- > 0;)
    if (robot.joints[j].parent >= 0)
      sum[static_cast<size_t>(robot.joints[j].parent)].add(
          sum[static_cast<size_t>(robot.joints[j].child)]);

  // Factors of M, sparse along the branches: M = L^T D L with rows of ancestors only.
  const size_t n = dofs.size();
  std::vector<std::vector<std::pair<size_t, double>>> rows(n);  // from the dof to the root
  for (size_t k = 0; k < n; ++k) {
    const auto child = static_cast<size_t>(robot.joints[dofs[k].joint].child);
    const Screw momentum = sum[child].momentum(dofs[k].screw);
    for (auto i = static_cast<int32_t>(k); i >= 0; i = dofs[static_cast<size_t>(i)].parent) {
      const Screw& s = dofs[static_cast<size_t>(i)].screw;
      double value = math::dot(s.angular, momentum.angular) + math::dot(s.linear, momentum.linear);
      if (i == static_cast<int32_t>(k)) value += dofs[k].armature;
      rows[k].emplace_back(static_cast<size_t>(i), value);
    }
  }
  for (size_t k = n; k-- > 0;) {
    if (!(rows[k][0].second > 0.0)) return result;
    for (size_t a = 1; a < rows[k].size(); ++a) {
      const double factor = rows[k][a].second / rows[k][0].second;
      auto& row = rows[rows[k][a].first];
      for (size_t b = a; b < rows[k].size(); ++b) row[b - a].second -= factor * rows[k][b].second;
      rows[k][a].second = factor;
    }
  }
  // (M^-1)_kk = |D^-1/2 L^-T e_k|^2: L^T spreads from a dof to its ancestors.
  for (size_t k = 0; k < n; ++k) {
    std::vector<double> x(rows[k].size(), 0.0);
    x[0] = 1.0;
    double inverse = 0.0;
    for (size_t a = 0; a < rows[k].size(); ++a) {
      const auto& row = rows[rows[k][a].first];
      inverse += x[a] * x[a] / row[0].second;
      for (size_t b = 1; b < row.size(); ++b) x[a + b] -= row[b].second * x[a];
    }
    result[dofs[k].joint][dofs[k].place] = 1.0 / inverse;
  }
  return result;
}

}  // namespace novaphy::detail
