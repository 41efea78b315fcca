// Merges links that FIXED joints connect.
#include "robot.h"

namespace novaphy::detail {

Quatd turn_from_z(const Vec3d& to) {
  const double length = std::sqrt(to.x * to.x + to.y * to.y + to.z * to.z);
  const Vec3d n = to / length;
  if (n.z < -1.0 + 1e-12) return {1.0, 0.0, 0.0, 0.0};
  const Quatd q = {-n.y, n.x, 0.0, 1.0 + n.z};
  const double norm = std::sqrt(q.x * q.x + q.y * q.y + q.w * q.w);
  return {q.x / norm, q.y / norm, 0.0, q.w / norm};
}

Mat33d turned(const Quatd& q, const Mat33d& inertia) {
  Mat33d half, result;
  for (int j = 0; j < 3; ++j) {
    const Vec3d c = math::rotate(q, Vec3d{inertia.m[0][j], inertia.m[1][j], inertia.m[2][j]});
    half.m[0][j] = c.x;
    half.m[1][j] = c.y;
    half.m[2][j] = c.z;
  }
  for (int i = 0; i < 3; ++i) {
    const Vec3d r = math::rotate(q, Vec3d{half.m[i][0], half.m[i][1], half.m[i][2]});
    result.m[i][0] = r.x;
    result.m[i][1] = r.y;
    result.m[i][2] = r.z;
  }
  return result;
}

namespace {

void add_moved(Mat33d& inertia, double mass, const Vec3d& p) {
  const double x = p.x, y = p.y, z = p.z;
  const double add[3][3] = {{y * y + z * z, -x * y, -x * z},
                            {-x * y, x * x + z * z, -y * z},
                            {-x * z, -y * z, x * x + y * y}};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) inertia.m[i][j] += mass * add[i][j];
}

}  // namespace

void add_mass(RobotLink& to, double mass, const Vec3d& com, const Mat33d& inertia) {
  if (mass == 0.0) return;
  to.axes.reset();
  const double sum = to.mass + mass;
  const Vec3d center = (to.com * to.mass + com * mass) / sum;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) to.inertia.m[i][j] += inertia.m[i][j];
  if (to.mass != 0.0) add_moved(to.inertia, to.mass, to.com - center);
  add_moved(to.inertia, mass, com - center);
  to.mass = sum;
  to.com = center;
}

// Returns the pose of the child's joint frame in the parent's joint frame at the initial
// coordinates.
Posed start_pose(const RobotJoint& joint) {
  Posed pose = identity_pose();
  if (quaternion_at(joint.type) == 0 && joint.start.size() == 4)
    pose.q = {joint.start[0], joint.start[1], joint.start[2], joint.start[3]};
  size_t k = 0;
  const auto unit = [](const Vec3f& a) {
    const Vec3d axis = {a.x, a.y, a.z};
    return axis / std::sqrt(math::dot(axis, axis));
  };
  for (const JointDofConfig& dof : joint.linear) {
    const double q = k < joint.start.size() ? joint.start[k] : 0.0;
    pose.p = pose.p + unit(dof.axis) * q;
    ++k;
  }
  for (const JointDofConfig& dof : joint.angular) {
    const double q = k < joint.start.size() ? joint.start[k] : 0.0;
    pose.q = math::multiply(pose.q, turn(unit(dof.axis), q));
    ++k;
  }
  return pose;
}

namespace {
bool is_merged(const Robot& robot, const RobotJoint& joint, std::span<const std::string> kept) {
  if (can_move(joint.type) || joint.parent < 0) return false;
  const std::string& name = robot.links[static_cast<size_t>(joint.child)].name;
  const auto gravcomp = [&](int32_t link) {
    return robot.links[static_cast<size_t>(link)].gravcomp;
  };
  return gravcomp(joint.parent) == gravcomp(joint.child) &&
         std::find(kept.begin(), kept.end(), name) == kept.end();
}
}  // namespace

void check_links(const Robot& robot, std::span<const std::string> names,
                 std::string_view function) {
  for (const std::string& name : names)
    require(std::any_of(robot.links.begin(), robot.links.end(),
                        [&](const RobotLink& link) { return link.name == name; }),
            ErrorKind::Value, function, ": links_to_keep: there is no link \"", name, "\"");
}

std::vector<std::pair<int32_t, Posed>> collapse_links(Robot& robot,
                                                      std::span<const std::string> to_keep,
                                                      std::vector<int32_t>& joints_out) {
  const auto count = static_cast<int32_t>(robot.links.size());
  std::vector<int32_t> mover(robot.links.size(), -1), renamed = mover;  // parent joint; new index
  for (size_t j = 0; j < robot.joints.size(); ++j)
    mover[static_cast<size_t>(robot.joints[j].child)] = static_cast<int32_t>(j);
  const auto joint_of = [&](int32_t link) -> const RobotJoint& {
    return robot.joints[static_cast<size_t>(mover[static_cast<size_t>(link)])];
  };
  const auto goes = [&](int32_t link) { return is_merged(robot, joint_of(link), to_keep); };
  std::vector<std::pair<int32_t, Posed>> place;
  int32_t next = 0;
  for (int32_t link = 0; link < count; ++link) {
    int32_t at = link;
    Posed pose = identity_pose();
    while (goes(at)) {
      const RobotJoint& joint = joint_of(at);
      pose =
          math::multiply(math::multiply(joint.parent_pose, math::inverse(joint.child_pose)), pose);
      at = joint.parent;
    }
    place.emplace_back(at, pose);
    if (at == link) renamed[static_cast<size_t>(link)] = next++;
  }
  for (int32_t link = 0; link < count; ++link) {
    const auto& [at, pose] = place[static_cast<size_t>(link)];
    if (at == link) continue;
    RobotLink& from = robot.links[static_cast<size_t>(link)];
    RobotLink& into = robot.links[static_cast<size_t>(at)];
    add_mass(into, from.mass, math::transform_point(pose, from.com), turned(pose.q, from.inertia));
    for (RobotShape& shape : from.shapes) {
      shape.pose = math::multiply(pose, shape.pose);
      into.shapes.push_back(std::move(shape));
    }
  }
  joints_out.assign(robot.joints.size(), -1);
  std::vector<RobotJoint> joints;
  for (size_t j = 0; j < robot.joints.size(); ++j) {
    RobotJoint& joint = robot.joints[j];
    if (goes(joint.child)) continue;
    joints_out[j] = static_cast<int32_t>(joints.size());
    joints.push_back(joint);
    RobotJoint& kept = joints.back();
    if (kept.parent >= 0) {
      const auto& [at, pose] = place[static_cast<size_t>(kept.parent)];
      kept.parent_pose = math::multiply(pose, kept.parent_pose);
      kept.parent = renamed[static_cast<size_t>(at)];
    }
    kept.child = renamed[static_cast<size_t>(kept.child)];
  }
  robot.joints = std::move(joints);
  std::vector<RobotLink> links;
  for (int32_t link = 0; link < count; ++link)
    if (renamed[static_cast<size_t>(link)] >= 0)
      links.push_back(std::move(robot.links[static_cast<size_t>(link)]));
  robot.links = std::move(links);
  for (auto& [at, pose] : place) at = renamed[static_cast<size_t>(at)];
  return place;
}

}  // namespace novaphy::detail
