#include "mjcf_start.h"

#include <cmath>

namespace novaphy::detail {
namespace {

// The motion of links for a unit rate of a dof. `linear` is the velocity of the point at the
// origin.
struct Screw {
  Vec3d angular{}, linear{};
};

// The inertia of a link and its subtree, about the origin of the world.
struct Inertia {
  double mass = 0.0;
  Vec3d moment{};  // mass times the center of mass
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
  size_t joint, place;  // joint, and index of the dof in the joint
  Screw screw;
  double armature;
  int32_t parent;  // previous dof on the path to the root; -1: none
};

// The mass matrix M at the initial pose, factored as L^T D L. All dofs count as free to move.
class StartDynamics {
 public:
  explicit StartDynamics(const Robot& robot)
      : robot_(robot),
        pose_(robot.links.size(), identity_pose()),
        last_(robot.links.size(), -1),
        places_(robot.joints.size(), 0) {
    std::vector<Inertia> sum(robot.links.size());
    for (size_t j = 0; j < robot.joints.size(); ++j) add_joint(j, sum);
    for (size_t j = robot.joints.size(); j-- > 0;)
      if (robot.joints[j].parent >= 0)
        sum[static_cast<size_t>(robot.joints[j].parent)].add(
            sum[static_cast<size_t>(robot.joints[j].child)]);
    factor(sum);
  }

  // Returns 1 / (M^-1)_kk for the dofs k of each joint, or 0 if M is not positive definite.
  std::vector<std::vector<double>> inertias() const {
    std::vector<std::vector<double>> result;
    for (const size_t count : places_) result.emplace_back(count, 0.0);
    for (size_t k = 0; is_definite_ && k < dofs_.size(); ++k) {
      std::vector<double> x(rows_[k].size(), 0.0);
      x[0] = 1.0;
      result[dofs_[k].joint][dofs_[k].place] = 1.0 / answer(k, x);
    }
    return result;
  }
  // Returns the inverse of the mass that a force at a link's center of mass accelerates, as the
  // mean over three directions.
  double inverse_mass(size_t link) const {
    if (last_[link] < 0 || !is_definite_) return 0.0;
    const auto k = static_cast<size_t>(last_[link]);
    const Vec3d com = math::transform_point(pose_[link], robot_.links[link].com);
    double sum = 0.0;
    for (const Vec3d& axis : kAxes) {
      std::vector<double> x;
      for (const auto& [dof, unused] : rows_[k]) {
        const Screw& s = dofs_[dof].screw;
        x.push_back(math::dot(axis, s.linear + math::cross(s.angular, com)));
      }
      sum += answer(k, x);
    }
    return sum / 3.0;
  }

 private:
  void add_joint(size_t j, std::vector<Inertia>& sum) {
    const RobotJoint& joint = robot_.joints[j];
    const auto child = static_cast<size_t>(joint.child);
    const Posed parent =
        joint.parent < 0 ? identity_pose() : pose_[static_cast<size_t>(joint.parent)];
    const Posed frame = math::multiply(parent, joint.parent_pose);
    pose_[child] =
        math::multiply(math::multiply(frame, start_pose(joint)), math::inverse(joint.child_pose));
    sum[child] = inertia_of(robot_.links[child], pose_[child]);
    int32_t before = joint.parent < 0 ? -1 : last_[static_cast<size_t>(joint.parent)];
    const Vec3d anchor = math::transform_point(pose_[child], joint.child_pose.p);
    const auto add = [&](const Vec3d& axis, bool turns, double armature) {
      dofs_.push_back({j, places_[j]++,
                       turns ? Screw{axis, math::cross(anchor, axis)} : Screw{{}, axis}, armature,
                       before});
      before = static_cast<int32_t>(dofs_.size()) - 1;
    };
    const bool is_free = joint.type == JointType::FREE && !robot_.links[child].is_kinematic;
    if (is_free)
      for (const Vec3d& axis : kAxes) add(axis, false, joint.armature);
    if (is_free || quaternion_at(joint.type) == 0)
      for (const Vec3d& axis : kAxes) add(axis, true, joint.armature);
    // At the initial pose the earlier angles of a joint are 0, so the axes are those of the joint
    // frame. A hinge with a ref has another angle, but such a hinge has no other axes.
    for (const auto* axes : {&joint.linear, &joint.angular})
      for (const JointDofConfig& dof : *axes)
        add(math::rotate(frame.q, Vec3d{dof.axis.x, dof.axis.y, dof.axis.z}),
            axes == &joint.angular, dof.armature);
    last_[child] = before;
  }

  // Factors M. The factor is sparse: the row of a dof has entries only for the dof and its
  // ancestors.
  void factor(const std::vector<Inertia>& sum) {
    rows_.resize(dofs_.size());  // entries from the dof to the root
    for (size_t k = 0; k < dofs_.size(); ++k) {
      const auto child = static_cast<size_t>(robot_.joints[dofs_[k].joint].child);
      const Screw momentum = sum[child].momentum(dofs_[k].screw);
      for (auto i = static_cast<int32_t>(k); i >= 0; i = dofs_[static_cast<size_t>(i)].parent) {
        const Screw& s = dofs_[static_cast<size_t>(i)].screw;
        double value =
            math::dot(s.angular, momentum.angular) + math::dot(s.linear, momentum.linear);
        if (i == static_cast<int32_t>(k)) value += dofs_[k].armature;
        rows_[k].emplace_back(static_cast<size_t>(i), value);
      }
    }
    for (size_t k = dofs_.size(); k-- > 0;) {
      is_definite_ = is_definite_ && rows_[k][0].second > 0.0;
      if (!is_definite_) return;
      for (size_t a = 1; a < rows_[k].size(); ++a) {
        const double factor = rows_[k][a].second / rows_[k][0].second;
        auto& row = rows_[rows_[k][a].first];
        for (size_t b = a; b < rows_[k].size(); ++b)
          row[b - a].second -= factor * rows_[k][b].second;
        rows_[k][a].second = factor;
      }
    }
  }

  // Returns x . M^-1 x = |D^-1/2 L^-T x|^2 for a vector x that is 0 except for dof k and its
  // ancestors. L^T couples a dof only with its ancestors.
  double answer(size_t k, std::vector<double> x) const {
    double sum = 0.0;
    for (size_t a = 0; a < rows_[k].size(); ++a) {
      const auto& row = rows_[rows_[k][a].first];
      sum += x[a] * x[a] / row[0].second;
      for (size_t b = 1; b < row.size(); ++b) x[a + b] -= row[b].second * x[a];
    }
    return sum;
  }

  const Robot& robot_;
  std::vector<Posed> pose_;
  std::vector<int32_t> last_;   // last dof of each link
  std::vector<size_t> places_;  // number of dofs of each joint
  std::vector<Dof> dofs_;
  std::vector<std::vector<std::pair<size_t, double>>> rows_;
  bool is_definite_ = true;
};

}  // namespace

std::vector<std::vector<double>> free_inertias(const Robot& robot) {
  return StartDynamics(robot).inertias();
}

void set_inverse_masses(Robot& robot) {
  const StartDynamics dynamics(robot);
  for (size_t k = 0; k < robot.links.size(); ++k)
    for (RobotShape& shape : robot.links[k].shapes)
      shape.cfg.mixing.inverse_mass = static_cast<float>(dynamics.inverse_mass(k));
}

}  // namespace novaphy::detail
