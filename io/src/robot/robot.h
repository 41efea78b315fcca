// The common description of URDF and MJCF files: a forest of links and joints in double precision,
// on its way into a ModelBuilder.
#pragma once

#include <cmath>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/io/mesh.h"
#include "novaphy/io/robot.h"
#include "novaphy/math/functions.h"
#include "novaphy/math/principal_axes.h"

namespace novaphy::detail {

using Vec3d = Vec3<double>;
using Quatd = Quat<double>;
using Posed = Transform<double>;
using Mat33d = Mat33<double>;

inline constexpr int32_t kWorldLink = -1;

struct RobotShape {
  GeoType type;
  Posed pose;   // in its link
  Vec3d scale;  // see GeoType; of a mesh its factors
  ShapeConfig cfg;
  std::string label, where;  // where: "file:line: <element>"
  std::filesystem::path mesh = {};
  std::shared_ptr<const Mesh> surface = {};   // instead of `mesh`, where it was read already
  std::optional<int32_t> hull_vertices = {};  // the convex hull of the mesh
  std::optional<Vec4f> color = {};
  uint32_t contype = 1, conaffinity = 1;  // of MJCF
  int32_t link = kWorldLink;              // of the file, also where that was merged
};

struct RobotLink {
  std::string name, where;
  double mass = 0.0;
  Vec3d com{};
  Mat33d inertia{};  // about com, along the axes of the link
  std::vector<RobotShape> shapes = {};
  bool is_kinematic = false;
  double gravcomp = 0.0;  // part of its weight that a force takes away
  // It only carries the next joint of a body that has several: a part of the link on that joint.
  bool is_between = false;
};

struct RobotJoint {
  std::string name, where;
  JointType type;
  int32_t parent, child;  // links
  Posed parent_pose, child_pose;
  std::vector<JointDofConfig> linear = {}, angular = {};
  std::vector<double> start = {};  // coordinates of linear and angular; empty: 0
  double damping = 0.0, armature = 0.0, friction = 0.0;  // of each axis of a BALL or FREE joint
  double stiffness = 0.0;                                // likewise, of a BALL, towards `rest`
  Quatd rest = {0.0, 0.0, 0.0, 1.0};
  double limit_angle = 0.0;         // of a BALL; 0: none
  std::string leader = {};          // joint that it follows; empty: none
  double coef0 = 0.0, coef1 = 1.0;  // its coordinate: coef0 + coef1 times the leader's
  bool meets_parent = false;        // the child's shapes do, and the parent's
  int32_t coordinates() const {
    return coordinate_count(type, static_cast<int32_t>(linear.size() + angular.size()));
  }
};

struct Robot {
  std::string name;
  std::vector<RobotLink> links = {};
  std::vector<RobotShape> world_shapes = {};
  std::vector<RobotJoint> joints = {};
  std::vector<std::pair<int32_t, int32_t>> excluded = {};  // links of the file that do not meet
  // Labels of shapes that meet whatever filters say.
  std::vector<std::pair<std::string, std::string>> pairs = {};
};

struct EmitOptions {
  std::string_view function;
  Posed xform;
  int32_t parent_body;
  bool collapse, self_collisions, bodies_follow;
  JointOrdering ordering;
  // Pairs as in MuJoCo: by contype and conaffinity; links welded to the world are a part of it.
  bool pairs_of_mujoco;
  std::span<const std::string> links_to_keep = {};  // by `collapse`
  bool filter_parent = true;  // links do not meet those that a joint connects them with
};

inline Posed identity_pose() { return {{0.0, 0.0, 0.0}, {0.0, 0.0, 0.0, 1.0}}; }
inline Posed to_double(const Transformf& x) {
  return {{x.p.x, x.p.y, x.p.z}, {x.q.x, x.q.y, x.q.z, x.q.w}};
}
inline Vec3f to_float(const Vec3d& v) {
  return {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)};
}
inline Transformf to_float(const Posed& x) {
  return {to_float(x.p),
          {static_cast<float>(x.q.x), static_cast<float>(x.q.y), static_cast<float>(x.q.z),
           static_cast<float>(x.q.w)}};
}
// A turn by `angle` about a unit vector.
inline Quatd turn(const Vec3d& axis, double angle) {
  const double s = std::sin(0.5 * angle);
  return {axis.x * s, axis.y * s, axis.z * s, std::cos(0.5 * angle)};
}
// The shortest turn of +z to a vector that is not zero.
Quatd turn_from_z(const Vec3d& to);
// R I R^T
Mat33d turned(const Quatd& q, const Mat33d& inertia);

// A picture of a mesh of several materials, as a shape for each color. `known`: parts that were
// made before. One of more than 64 colors stays whole.
using MeshParts = std::map<std::shared_ptr<const Mesh>, std::vector<std::shared_ptr<const Mesh>>>;
void add_parts(const RobotShape& whole, MeshParts& known, std::vector<RobotShape>& to);

// What a BALL or FREE joint has besides its frames, of the one that was added last.
void set_ball(const RobotJoint& joint, ModelBuilder& builder);

// Adds what has a mass, a center and an inertia about that, in the frame of the link.
void add_mass(RobotLink& to, double mass, const Vec3d& com, const Mat33d& inertia);

// Whether a body may have this inertia: positive definite, also when it is rounded to float32.
bool has_extent(const Mat33d& inertia);
using math::principal_axes;
using math::PrincipalAxes;
// R diag(moments) R^T
Mat33d from_axes(const PrincipalAxes& axes);
// What a file gives a mass and no inertia, or the other way round. On a fixed joint its parent gets
// both, which moves alike, and the world, if it is below, forgets them; else, if `moving`,
// principal moments are at least those of a ball of water of that mass. `mended(link, text)` hears
// of the latter.
void mend_inertias(Robot& robot, bool moving, bool on_world,
                   const std::function<void(size_t, const std::string&)>& mended);

// The pose of the child's joint frame in the parent's at the start.
Posed start_pose(const RobotJoint& joint);

// ErrorKind::Value: there is no link of a name.
void check_links(const Robot& robot, std::span<const std::string> names, std::string_view function);
// Merges every link that hangs on a FIXED joint below another link into that. Returns, of each old
// link, the link that it is part of now and its pose there; joints_out: the new index of each
// joint, -1: it is gone.
std::vector<std::pair<int32_t, Posed>> collapse_links(Robot& robot,
                                                      std::span<const std::string> kept,
                                                      std::vector<int32_t>& joints_out);

// Adds the robot to the builder, or throws and leaves the builder as it was.
RobotImport emit_robot(ModelBuilder& builder, Robot robot, const EmitOptions& options);

}  // namespace novaphy::detail
