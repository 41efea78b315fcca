// The common description of URDF and MJCF files before they are added to a ModelBuilder: trees of
// links and joints in double precision.
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
  Posed pose;   // pose in its link
  Vec3d scale;  // see GeoType; for a mesh, scale factors
  ShapeConfig cfg;
  std::string label, where;  // where: "file:line: <element>"
  std::filesystem::path mesh = {};
  std::shared_ptr<const Mesh> surface = {};   // mesh that was read already, in place of `mesh`
  std::optional<int32_t> hull_vertices = {};  // largest number of vertices, if the convex hull of
                                              // the mesh collides
  std::optional<Vec4f> color = {};
  uint32_t contype = 1, conaffinity = 1;  // MuJoCo's collision bits
  int32_t link = kWorldLink;              // link of the file, even if it was merged
};

struct RobotLink {
  std::string name, where;
  double mass = 0.0;
  Vec3d com{};
  Mat33d inertia{};  // kg m^2, about com, along the axes of the link
  std::vector<RobotShape> shapes = {};
  bool is_kinematic = false;
  double gravcomp = 0.0;  // fraction of the weight that gravity compensation cancels
  // Rotation of the principal axes in the link, if the file gives one.
  std::optional<Quatd> axes = {};
  // Whether the link only connects two joints of one body. Such a link counts as a part of the
  // body.
  bool is_between = false;
};

struct RobotJoint {
  std::string name, where;
  JointType type;
  int32_t parent, child;  // links
  Posed parent_pose, child_pose;
  std::vector<JointDofConfig> linear = {}, angular = {};
  std::vector<double> start = {};  // initial coordinates of linear and angular axes; empty: 0
  double damping = 0.0, armature = 0.0, friction = 0.0;  // for each axis of a BALL or FREE joint
  double stiffness = 0.0;                                // for each axis of a BALL joint, towards
                                                         // `rest`
  Quatd rest = {0.0, 0.0, 0.0, 1.0};
  double limit_angle = 0.0;         // rad, of a BALL joint; 0: no limit
  std::string leader = {};          // joint that this joint mimics; empty: none
  double coef0 = 0.0, coef1 = 1.0;  // coordinate = coef0 + coef1 * leader's coordinate
  bool meets_parent = false;        // whether shapes of child and parent may collide
  int32_t coordinates() const {
    return coordinate_count(type, static_cast<int32_t>(linear.size() + angular.size()));
  }
};

struct Robot {
  std::string name;
  std::vector<RobotLink> links = {};
  std::vector<RobotShape> world_shapes = {};
  std::vector<RobotJoint> joints = {};
  // pairs of links of the file whose shapes do not collide
  std::vector<std::pair<int32_t, int32_t>> excluded = {};
  // Labels of two shapes that may collide, whatever the filters say.
  std::vector<std::pair<std::string, std::string>> pairs = {};
};

struct EmitOptions {
  std::string_view function;
  Posed xform;
  int32_t parent_body;
  bool collapse, self_collisions, bodies_follow;
  JointOrdering ordering;
  // Whether MuJoCo's rules select pairs of shapes: contype and conaffinity decide, and links welded
  // to the world belong to the world.
  bool pairs_of_mujoco;
  std::span<const std::string> links_to_keep = {};  // links that `collapse` keeps
  bool filter_parent = true;  // links do not collide with their parent and children
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
// Returns a rotation by `angle` about a unit vector.
inline Quatd turn(const Vec3d& axis, double angle) {
  const double s = std::sin(0.5 * angle);
  return {axis.x * s, axis.y * s, axis.z * s, std::cos(0.5 * angle)};
}
// Returns the shortest rotation from +z to a nonzero vector.
Quatd turn_from_z(const Vec3d& to);
// Returns an inertia in rotated axes: R I R^T, where R is the rotation q.
Mat33d turned(const Quatd& q, const Mat33d& inertia);

// Adds the display shape of a mesh with several materials as one shape per color. `known` has the
// parts of meshes that were split before. A mesh with more than 64 colors is not split.
using MeshParts = std::map<std::shared_ptr<const Mesh>, std::vector<std::shared_ptr<const Mesh>>>;
void add_parts(const RobotShape& whole, MeshParts& known, std::vector<RobotShape>& to);

// Sets the properties of the BALL or FREE joint that was added last, except its frames.
void set_ball(const RobotJoint& joint, ModelBuilder& builder);

// Adds a mass to a link, with its center and its inertia about the center, in the frame of the
// link.
void add_mass(RobotLink& to, double mass, const Vec3d& com, const Mat33d& inertia);

// Returns whether an inertia is physical: positive definite, even after rounding to float32.
bool has_extent(const Mat33d& inertia);
using math::principal_axes;
using math::PrincipalAxes;
// Returns R diag(moments) R^T, the inertia with these principal axes and moments.
Mat33d from_axes(const PrincipalAxes& axes);
// Corrects links that have a mass and no inertia, or an inertia and no mass. The parent of a fixed
// joint gets mass and inertia of such a link, because the two links have the same motion. If
// `moving`, the moments of other such links are raised to those of a ball of water of the same
// mass, and `mended(link, text)` reports each correction. Otherwise, a link that is fixed to the
// world loses its mass, and other links stay unchanged.
void mend_inertias(Robot& robot, bool moving,
                   const std::function<void(size_t, const std::string&)>& mended);

// Returns the pose of the child's joint frame in the parent's joint frame at the initial
// coordinates.
Posed start_pose(const RobotJoint& joint);

// Throws ErrorKind::Value if a name belongs to no link.
void check_links(const Robot& robot, std::span<const std::string> names, std::string_view function);
// Merges every link on a FIXED joint into its parent link. Returns for each old link the link to
// which it belongs now, and its pose in that link. `joints_out` gets the new index of each joint;
// -1: removed.
std::vector<std::pair<int32_t, Posed>> collapse_links(Robot& robot,
                                                      std::span<const std::string> kept,
                                                      std::vector<int32_t>& joints_out);

// Adds the robot to the builder. After an error the builder is unchanged.
RobotImport emit_robot(ModelBuilder& builder, Robot robot, const EmitOptions& options);

}  // namespace novaphy::detail
