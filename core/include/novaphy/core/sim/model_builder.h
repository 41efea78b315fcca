// ModelBuilder: collects particles, elements over them, bodies and shapes, checks them, and makes
// Models.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <set>
#include <span>
#include <string>
#include <string_view>
#include <unordered_map>
#include <utility>
#include <vector>

#include "novaphy/core/device.h"
#include "novaphy/core/geometry/convex_hull.h"
#include "novaphy/core/geometry/mesh_mass.h"
#include "novaphy/core/sim/actuator_list.h"
#include "novaphy/core/sim/element_args.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/core/sim/joint_args.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/shape_config.h"

namespace novaphy {

namespace detail {
struct MassProperties;
}

// Gravity of a builder, m/s^2: a number along the up axis (so usually negative), or a vector.
struct GravitySpec {
  std::optional<float> along_up = -9.81f;
  Vec3f vector{};
  GravitySpec() = default;
  GravitySpec(float value) : along_up(value) {}
  GravitySpec(const Vec3f& value) : along_up(), vector(value) {}
};

// A rigid body. Mass and inertia given here are the base, without shapes: each shape with a density
// adds its own, in the order in which they are added, and moves the center of mass.
struct BodyArgs {
  Transformf xform = Transformf::identity();  // pose of the body's origin in the world
  Vec3f com{};                                // m, body frame: center of the base mass
  float mass = 0.0f;                          // kg
  // kg m^2, about `com`, along the axes of the body; a point mass has none.
  std::optional<Mat33f> inertia = {};
  bool lock_inertia = false;  // shapes add nothing
  bool is_kinematic = false;  // follows its velocity, no force moves it; needs no mass
  float gravcomp = 0.0f;      // part of the weight that a force at the center of mass takes away
  std::string label = {};     // "body_<index>" when empty
};

// The options of the add_shape_* functions. An empty `cfg` means ModelBuilder::default_shape_cfg;
// an empty `label` means "shape_<index>". `xform` is the pose of the shape in its body, in the
// world for body -1.
struct ShapeArgs {
  int32_t body = -1;
  GeoType type = GeoType::NONE;
  Transformf xform = Transformf::identity();
  Vec3f scale{};  // see GeoType
  std::optional<ShapeConfig> cfg = {};
  std::string label = {};
  bool is_static = false;  // adds no mass to its body, whatever the density
};
struct ShapePlaneArgs {
  Vec4f plane{0.0f, 0.0f, 1.0f,
              0.0f};  // a*x + b*y + c*z + d = 0, normal (a, b, c): (0, 0, 1, -h) is z = h
  std::optional<Transformf> xform = {};  // wins over `plane`; local +z is the normal
  float width = 10.0f, length = 10.0f;   // m, along local x and y; infinite unless both are > 0
  int32_t body = -1;
  std::optional<ShapeConfig> cfg = {};
  std::string label = {};
};
struct GroundArgs {
  float height = 0.0f;  // m along the up axis
  std::optional<ShapeConfig> cfg = {};
  std::string label = "ground_plane";
};
struct ShapeSphereArgs {
  Transformf xform = Transformf::identity();
  float radius = 1.0f;  // m
  std::optional<ShapeConfig> cfg = {};
  std::string label = {};
};
struct ShapeBoxArgs {
  Transformf xform = Transformf::identity();
  float hx = 0.5f, hy = 0.5f, hz = 0.5f;  // m, half extents
  std::optional<ShapeConfig> cfg = {};
  std::string label = {};
};
struct ShapeCapsuleArgs {
  Transformf xform = Transformf::identity();
  float radius = 1.0f, half_height = 0.5f;  // m; along local z, half_height excludes the caps
  std::optional<ShapeConfig> cfg = {};
  std::string label = {};
};

struct ShapeCylinderArgs {
  Transformf xform = Transformf::identity();
  float radius = 1.0f, half_height = 0.5f;  // m; along local z
  std::optional<ShapeConfig> cfg = {};
  std::string label = {};
};
struct ShapeConeArgs {
  Transformf xform = Transformf::identity();
  float radius = 1.0f, half_height = 0.5f;  // m; along local z, apex at +half_height
  std::optional<ShapeConfig> cfg = {};
  std::string label = {};
};
struct ShapeEllipsoidArgs {
  Transformf xform = Transformf::identity();
  float rx = 1.0f, ry = 0.75f, rz = 0.5f;  // m, half axes
  std::optional<ShapeConfig> cfg = {};
  std::string label = {};
};
// A surface of triangles, counter-clockwise seen from outside. Vertices in the same place, to the
// bit, count as one; those that no triangle uses are left out.
struct ShapeMeshArgs {
  Transformf xform = Transformf::identity();
  std::span<const Vec3f> vertices = {};   // m, before `scale`
  std::span<const int32_t> indices = {};  // 3 per triangle
  Vec3f scale{1.0f, 1.0f, 1.0f};          // > 0
  std::optional<ShapeConfig> cfg = {};
  std::string label = {};
};
// The convex hull of points, see convex_hull (core/geometry/convex_hull.h).
struct ShapeConvexHullArgs {
  Transformf xform = Transformf::identity();
  std::span<const Vec3f> vertices = {};     // m, before `scale`
  Vec3f scale{1.0f, 1.0f, 1.0f};            // > 0
  int32_t max_vertices = kMaxHullVertices;  // of the hull, 4 .. kMaxHullVertices
  std::optional<ShapeConfig> cfg = {};
  std::string label = {};
};

// What ModelBuilder::color does.
struct ColorArgs {
  // Whether the corners of a bending edge get different colors; empty: where it has a stiffness or
  // damping. False: they may share one, and a stiff hinge then converges badly or not at all.
  std::optional<bool> include_bending = {};
  bool balance_colors = true;  // moves particles until the colors are about equally large
};

struct FinalizeOptions {
  bool requires_grad = false;
  bool skip_validation = false;  // no second check of values; the lists' sizes are checked
};

// Every add_* function checks its arguments and leaves the builder as it was when one is bad:
//   ErrorKind::Value           not finite, negative, non-positive extent, quaternion not of unit
//   length, ...
//   ErrorKind::Index           a body, shape or vertex that is not there
//   ErrorKind::NotImplemented  a shape type that is not supported
// Quaternions may miss unit length by 1e-3 and are then normalized; one that is already of unit
// length to float rounding keeps its bits.
class NOVAPHY_CORE_API ModelBuilder {
 public:
  explicit ModelBuilder(Axis up_axis = Axis::Z, const GravitySpec& gravity = {});

  Axis up_axis() const { return up_axis_; }
  Vec3f up_vector() const { return axis_vector(up_axis_); }

  // Settings for what is added later.
  // m/s^2, world frame: the gravity of worlds whose begin_world names none, and without worlds.
  Vec3f gravity;
  float default_particle_radius = 0.1f;  // m
  ShapeConfig default_shape_cfg;
  JointDofConfig default_joint_cfg;
  float rigid_gap = 0.1f;  // m: the gap of shapes whose ShapeConfig has none
  // Of dynamic bodies with a mass, read by finalize, which warns of what it changes; the same
  // multiple of the identity is added to an inertia in all directions.
  // Whether principal moments that break the triangle inequality are raised; false: an error.
  bool balance_inertia = true;
  std::optional<float> bound_mass = {};     // kg, > 0: a smaller mass becomes this
  std::optional<float> bound_inertia = {};  // kg m^2, > 0: smaller principal moments are raised
  // Materials of elements, where add_* is given none.
  float default_tri_ke = 100.0f, default_tri_ka = 100.0f, default_tri_kd = 10.0f;
  float default_tri_drag = 0.0f, default_tri_lift = 0.0f;
  float default_spring_ke = 100.0f, default_spring_kd = 0.0f;
  float default_edge_ke = 100.0f, default_edge_kd = 0.0f;
  float default_tet_k_mu = 1.0e3f, default_tet_k_lambda = 1.0e3f, default_tet_k_damp = 0.0f;
  float default_tet_density = 1.0f;  // kg/m^3

  // The particles so far. Values may be edited before finalize, which checks them again.
  std::vector<Vec3f> particle_q, particle_qd;  // m, m/s, world
  std::vector<float> particle_mass;            // kg
  std::vector<float> particle_radius;          // m
  std::vector<int32_t> particle_flags;         // ParticleFlags
  std::vector<int32_t> particle_world;         // -1: all worlds

  // The bodies' initial poses and velocities, see Model::body_q, body_qd; editable as the
  // particles.
  std::vector<Transformf> body_q;
  std::vector<SpatialVectorf> body_qd;

  // The joints' values, see Model; editable as the particles. joint_q and joint_target_q have a row
  // per coordinate, the others one per degree of freedom. The initial coordinates of a body of
  // add_body follow body_q and body_qd until they are edited themselves.
  std::vector<float> joint_q, joint_target_q;
  std::vector<int32_t> joint_target_mode;
#define NOVAPHY_BUILDER_LIST(name, ...) std::vector<float> name;
  NOVAPHY_MODEL_JOINT_DOF_FIELDS(NOVAPHY_BUILDER_LIST)
#undef NOVAPHY_BUILDER_LIST

  int32_t world_count() const { return static_cast<int32_t>(world_gravity_.size()); }
  int32_t current_world() const { return current_world_; }  // -1: outside of begin_world, end_world
  int32_t particle_count() const { return static_cast<int32_t>(particle_q.size()); }
  int32_t body_count() const { return static_cast<int32_t>(bodies_.size()); }
  int32_t shape_count() const { return static_cast<int32_t>(shapes_.size()); }
  int32_t joint_count() const { return static_cast<int32_t>(joints_.size()); }
  int32_t joint_coord_count() const { return static_cast<int32_t>(joint_q.size()); }
  int32_t joint_dof_count() const { return static_cast<int32_t>(joint_qd.size()); }
  int32_t articulation_count() const { return static_cast<int32_t>(articulations_.size()); }
  int32_t actuator_count() const { return actuators_.count(); }
  int32_t spring_count() const { return static_cast<int32_t>(springs_.indices.size()); }
  int32_t tri_count() const { return static_cast<int32_t>(triangles_.indices.size()); }
  int32_t edge_count() const { return static_cast<int32_t>(edges_.indices.size()); }
  int32_t tet_count() const { return static_cast<int32_t>(tetrahedra_.indices.size()); }

  // Returns the index. `mass` 0 makes the particle kinematic: it keeps its velocity.
  int32_t add_particle(const Vec3f& pos, const Vec3f& vel, float mass,
                       std::optional<float> radius = {},
                       int32_t flags = static_cast<int32_t>(ParticleFlags::ACTIVE));
  // The lists have one length (ErrorKind::Value); empty `radius` and `flags` mean the defaults.
  void add_particles(std::span<const Vec3f> pos, std::span<const Vec3f> vel,
                     std::span<const float> mass, std::span<const float> radius = {},
                     std::span<const int32_t> flags = {});

  // Elements over particles, which must be there (ErrorKind::Index). Their rest shape is that of
  // the present positions; one without a size is refused and named (ErrorKind::Value): an area up
  // to 1e-7 of the longest edge squared, a volume up to 1e-7 of it cubed, an inverted tetrahedron.
  // Materials are finite and >= 0.
  // A spring, its rest length the present distance; `control` is stored only. With `tension_only` a
  // rope: it pulls where it is longer than at rest, and never pushes. Returns the index.
  int32_t add_spring(int32_t i, int32_t j, float ke, float kd, float control = 0.0f,
                     bool tension_only = false);
  // A triangle, counter-clockwise. Returns its area (m^2).
  float add_triangle(int32_t i, int32_t j, int32_t k, const TriMaterial& material = {});
  // Many; `materials`: none, one for all, or one each. Returns their areas.
  std::vector<float> add_triangles(std::span<const Vec3i> indices,
                                   std::span<const TriMaterial> materials = {});
  // A tetrahedron, l where (i, j, k) turns counter-clockwise. Returns its volume (m^3), > 0.
  float add_tetrahedron(int32_t i, int32_t j, int32_t k, int32_t l, std::optional<float> k_mu = {},
                        std::optional<float> k_lambda = {}, std::optional<float> k_damp = {});
  // Many; each material: none, one for all, or one each. Returns their volumes.
  std::vector<float> add_tetrahedra(std::span<const Vec4i> indices,
                                    std::span<const float> k_mu = {},
                                    std::span<const float> k_lambda = {},
                                    std::span<const float> k_damp = {});
  // A bending edge from k to l between the triangles (i, k, l) and (j, l, k); i or j may be -1: a
  // border without a force. `rest` (rad): empty for the present angle. Returns the index.
  int32_t add_edge(int32_t i, int32_t j, int32_t k, int32_t l, std::optional<float> rest = {},
                   const EdgeMaterial& material = {});
  // Many; `rest`: one each, or none; `materials`: none, one for all, or one each.
  void add_edges(std::span<const Vec4i> indices, std::span<const float> rest = {},
                 std::span<const EdgeMaterial> materials = {});

  // Whole grids and meshes, see element_args.h. Meshes are refused (ErrorKind::Value) when they are
  // empty, have a vertex that no element uses, or an edge or face that too many elements share.
  void add_particle_grid(const ParticleGridArgs& args);
  void add_cloth_grid(const ClothGridArgs& args);
  void add_cloth_mesh(const ClothMeshArgs& args);
  void add_soft_grid(const SoftGridArgs& args);
  void add_soft_mesh(const SoftMeshArgs& args);

  // A rigid body that moves freely, at rest: a link, its FREE joint to the world, and an
  // articulation of that. Returns the index. ErrorKind::Value: a mass or inertia that no body has;
  // also from finalize, of what the body and its shapes come to.
  int32_t add_body(const BodyArgs& args = {});
  // A rigid body for joints to hold, also without mass; finalize refuses the child of no joint.
  int32_t add_link(const BodyArgs& args = {});

  // Joints: the child body relative to the parent, -1 the world. Return the index.
  // ErrorKind::Value: a bad pose, axis or number, limits in the wrong order, child and parent the
  // same, bodies of two worlds; ErrorKind::Index: no such body. Coordinates start at 0, those of
  // FREE and DISTANCE joints at the present poses of the bodies. Shapes of the child with
  // ShapeConfig::collision_filter_parent do not meet those of the parent body.
  int32_t add_joint(JointType type, int32_t parent, int32_t child, const JointArgs& args = {});
  int32_t add_joint_revolute(int32_t parent, int32_t child, const AxisJointArgs& args = {});
  int32_t add_joint_prismatic(int32_t parent, int32_t child, const AxisJointArgs& args = {});
  int32_t add_joint_ball(int32_t parent, int32_t child, const BallJointArgs& args = {});
  int32_t add_joint_fixed(int32_t parent, int32_t child, const JointArgs& args = {});
  int32_t add_joint_free(int32_t child, const FreeJointArgs& args = {});
  int32_t add_joint_distance(int32_t parent, int32_t child, const DistanceJointArgs& args = {});
  int32_t add_joint_d6(int32_t parent, int32_t child, const JointArgs& args = {});
  int32_t add_joint_planar(int32_t parent, int32_t child, const Vec3f& axis, JointArgs args = {});
  // A tree of joints, root first: their indices, contiguous and increasing, in any order in which
  // parents come before children. Returns the index. ErrorKind::Value: another order, two joints
  // with one child, a second root, a joint of another articulation or world, a kinematic body that
  // is not the root's; a cycle has no such order.
  int32_t add_articulation(std::span<const int32_t> joints, std::string label = {});
  // Makes joint0 follow joint1: q0 = coef0 + coef1 q1, in every step of articulations; both are
  // REVOLUTE or PRISMATIC, and of one articulation. Drives, limits, forces and inertia of joint0
  // act on joint1; its velocity limit does not. A mimic joint may lead others. The model's first
  // joint_q and joint_qd of joint0 are those of joint1. ErrorKind::Index: no such joint.
  // ErrorKind::Value: a joint of another type, one that follows already, a cycle, numbers that are
  // not finite; when the model is made: joints of different articulations.
  void add_constraint_mimic(int32_t joint0, int32_t joint1, float coef0 = 0.0f, float coef1 = 1.0f);
  // An actuator of a joint with axes (joint_types.h), or of a body (-1: the world). Returns the
  // index, the row of Control::ctrl. ErrorKind::Index: no such joint, axis or body;
  // ErrorKind::Value: a joint of another type, a range in the wrong order, numbers that are not
  // finite, a frame whose quaternion is not of length 1, a time constant that is not > 0.
  int32_t add_actuator(int32_t joint, const ActuatorArgs& args = {});
  int32_t add_body_actuator(int32_t body, const BodyActuatorArgs& args = {});
  // Makes finalize raise ErrorKind::NotImplemented: `why` names a part that no solver has.
  void refuse_at_finalize(std::string why) { refused_.push_back(std::move(why)); }
  // Merges the child of every enabled FIXED joint into the parent: mass, shapes and joints. Joints
  // with a label in `keep` stay; so do those whose child has another joint to a parent, is
  // kinematic under a body, or has another gravcomp, and a root with more than one child in its
  // articulation.
  CollapsedJoints collapse_fixed_joints(std::span<const std::string> keep = {});

  // All return the index of the shape. `body` -1 is the world. A plane belongs to the world or to a
  // kinematic body.
  int32_t add_shape(const ShapeArgs& args);
  int32_t add_shape_plane(const ShapePlaneArgs& args = {});
  int32_t add_ground_plane(const GroundArgs& args = {});  // infinite, its normal is the up axis
  int32_t add_shape_sphere(int32_t body, const ShapeSphereArgs& args = {});
  int32_t add_shape_box(int32_t body, const ShapeBoxArgs& args = {});
  int32_t add_shape_capsule(int32_t body, const ShapeCapsuleArgs& args = {});
  int32_t add_shape_cylinder(int32_t body, const ShapeCylinderArgs& args = {});
  int32_t add_shape_cone(int32_t body, const ShapeConeArgs& args = {});
  int32_t add_shape_ellipsoid(int32_t body, const ShapeEllipsoidArgs& args = {});
  // Where it has a density and a body, a mesh must be closed: see mesh_properties and, for a shell,
  // shell_properties (core/geometry/mesh_mass.h), whose wall is cfg.margin. ErrorKind::Value: no
  // triangle; indices out of range; two corners of a triangle in one place; a number that is not
  // finite, a scale <= 0.
  int32_t add_shape_mesh(int32_t body, const ShapeMeshArgs& args);
  // ErrorKind::Value: what convex_hull refuses, a scale <= 0.
  int32_t add_shape_convex_hull(int32_t body, const ShapeConvexHullArgs& args);
  // A named frame: a shape with ShapeFlags::SITE, which meets nothing and has no mass.
  int32_t add_site(const ShapeArgs& args);

  // The two shapes never meet. ErrorKind::Index: no such shape; ErrorKind::Value: a == b.
  void add_shape_collision_filter_pair(int32_t a, int32_t b);

  // Worlds: what is added between begin_world and end_world belongs to one world and meets only
  // what belongs to it or to all worlds (-1), which is what is added outside. A model without
  // worlds has one. begin_world returns the number of the world; `gravity` is the builder's when
  // empty. ErrorKind::Runtime: a world is open already, or none is; ErrorKind::Value: not finite.
  int32_t begin_world(std::optional<Vec3f> gravity = {});
  void end_world();
  // Adds all of another builder, moved by `xform`, to the current world, whatever world it had
  // there, and takes that builder's gravity for this world (outside of worlds: for this builder).
  // ErrorKind::Value: another up axis, this builder itself, a bad pose, or too many particles.
  void add_builder(const ModelBuilder& builder, const Transformf& xform = Transformf::identity());
  // begin_world, add_builder, end_world. Returns the number of the world.
  int32_t add_world(const ModelBuilder& builder, const Transformf& xform = Transformf::identity());
  // add_world `world_count` times, on a grid of `spacing` (m, world frame) that spans the axes
  // where it is not 0 and is centerd at the origin, but for the up axis, which it starts at 0.
  void replicate(const ModelBuilder& builder, int32_t world_count, const Vec3f& spacing = {});

  // Colors the particles, so that no two of one element have the same color: springs, triangles,
  // tetrahedra and bending edges that have a stiffness or damping. SolverVBD moves the particles of
  // one color together. Greedy in smallest-last order, ties by index: the same elements give the
  // same colors. What is added afterwards has no color.
  void color(const ColorArgs& args = {});
  // The particles of each color instead. ErrorKind::Value: a group without particles, a particle
  // in two groups or in none, and an element, which is named, with two corners of one color unless
  // `allow_conflicts`. ErrorKind::Index: a particle that is not there.
  void set_coloring(std::span<const std::vector<int32_t>> groups, bool allow_conflicts = false);

  // Checks everything and makes a model; the builder stays as it is and may be used again. `device`
  // must be there (ErrorKind::Runtime).
  std::shared_ptr<Model> finalize(Device device = default_device(),
                                  const FinalizeOptions& options = {}) const;

 private:
  // What a body is without its shapes, but for its pose and velocity.
  struct Body {
    Vec3f com;
    float mass;
    Mat33f inertia;  // zero: a point mass
    bool lock_inertia;
    bool is_kinematic;
    bool is_link;
    int32_t world;
    std::string label = {};
    float gravcomp = 0.0f;
    int32_t mover = -1;        // the joint of an articulation whose child it is
    Transformf added_at = {};  // of add_body: what its joint coordinates started as
  };
  struct Joint {
    JointType type;
    int32_t parent, child;
    Transformf parent_xform, child_xform;
    int32_t linear, angular;    // degrees of freedom
    int32_t q_start, qd_start;  // rows of joint_q and joint_qd
    std::vector<Vec3f> axes;    // unit vectors, one per degree of freedom
    bool filter_parent, enabled;
    int32_t articulation = -1;
    std::string label = {};
    int32_t mimic = -1;  // joint that it follows
    Vec2f mimic_coef = {};
  };
  struct Articulation {
    int32_t start, end;  // joints
    std::string label;
  };
  struct Mesh {
    std::vector<Vec3f> vertices;
    std::vector<Vec3i> triangles;
    bool operator==(const Mesh&) const = default;
  };
  // The arrays of the model's meshes: each once, in the order of the shapes.
  struct MeshPool {
    std::vector<Vec3f> vertices;
    std::vector<Vec3i> triangles;
    std::vector<int32_t> ranges;  // 4 per shape
  };
  struct Shape {
    int32_t body;
    GeoType type;
    Transformf xform;
    Vec3f scale;
    ShapeConfig cfg;
    float gap;
    int32_t world;
    std::string label = {};
    std::shared_ptr<const Mesh> mesh = {};  // of MESH and CONVEX_MESH
    SolidProperties solid = {};             // of the scaled mesh; empty where no mass is asked for
  };

  // One vector per array of the model, a row per element.
  struct Springs {
    std::vector<Vec2i> indices;
    std::vector<float> rest_length, stiffness, damping, control;
    std::vector<uint8_t> tension_only;
  };
  struct Triangles {
    std::vector<Vec3i> indices;
    std::vector<Mat22f> pose;
    std::vector<float> area, material;  // material: 5 per triangle
  };
  struct Edges {
    std::vector<Vec4i> indices;
    std::vector<float> rest_angle, rest_length, material;  // material: 2 per edge
  };
  struct Tetrahedra {
    std::vector<Vec4i> indices;
    std::vector<Mat33f> pose;
    std::vector<float> volume, material;  // material: 3 per tetrahedron
  };
  class Transaction;
  // The arrays of the bodies with their shapes, a row per body.
  struct BodyMasses {
    std::vector<float> mass;
    std::vector<Vec3f> com;
    std::vector<Mat33f> inertia;
  };

  int32_t append_body(std::string_view function, const BodyArgs& args, bool is_link);
  int32_t append_joint(std::string_view function, JointType type, int32_t parent, int32_t child,
                       const JointArgs& args);
  int32_t append_axis_joint(std::string_view function, JointType type, int32_t parent,
                            int32_t child, const AxisJointArgs& args);
  int32_t next_coord() const;  // the coordinates of the joints so far
  int32_t next_dof() const;
  Transformf relative_pose(const Joint& joint) const;
  void append_joints(const ModelBuilder& builder, int32_t first_body, const Transformf& xform);
  std::vector<char> joints_that_stay(std::span<const std::string> keep) const;
  void merge_bodies(const std::vector<int32_t>& into, const std::vector<Transformf>& pose);
  CollapsedJoints drop_merged(const std::vector<int32_t>& into, const std::vector<Transformf>& pose,
                              const std::vector<char>& joint_stays);
  void check_joints() const;
  void upload_joints(Model& model) const;
  std::set<std::pair<int32_t, int32_t>> all_filter_pairs() const;
  // `mesh`: of MESH and CONVEX_MESH.
  int32_t append_shape(std::string_view function, const ShapeArgs& args,
                       std::shared_ptr<const Mesh> mesh = {});
  std::shared_ptr<const Mesh> shared_mesh(Mesh mesh);
  static SolidProperties solid_properties(std::string_view function, GeoType type, const Mesh& mesh,
                                          const Vec3f& scale, const ShapeConfig& cfg);
  MeshPool mesh_pool() const;
  void append_spring(std::string_view function, const Vec2i& spring, float ke, float kd,
                     float control, bool tension_only);
  float append_triangle(std::string_view function, const Vec3i& triangle,
                        const TriMaterial& material);
  float append_tetrahedron(std::string_view function, const Vec4i& tetrahedron, float k_mu,
                           float k_lambda, float k_damp);
  void append_edge(std::string_view function, const Vec4i& edge, std::optional<float> rest,
                   const EdgeMaterial& material);
  int32_t append_vertices(std::string_view function, const Placement& placement, double scale,
                          std::span<const Vec3f> vertices, std::optional<float> radius);
  void append_cloth(std::string_view function, const ClothMeshArgs& args);
  void append_surface(std::string_view function, std::span<const Vec4i> tetrahedra,
                      const TriMaterial& tri, bool add_edges, const EdgeMaterial& edge);
  void append_elements(const ModelBuilder& builder);
  void check_addable(std::string_view function, const ModelBuilder& builder, int64_t copies) const;
  void append_bodies(const ModelBuilder& builder, const Transformf& xform);
  static detail::MassProperties base_mass(const Body& body);
  std::vector<detail::MassProperties> exact_body_masses() const;  // with their shapes
  BodyMasses body_masses() const;
  // Calls visit(kind, element, its particles; -1: none) for the elements that colors keep apart.
  template <class Visit>
  void visit_colored_elements(bool bending, Visit&& visit) const;
  void check_coloring(std::string_view function) const;
  void upload_elements(Model& model) const;
  void upload_bodies(Model& model, const BodyMasses& masses) const;
  void check_sizes() const;
  void check_values() const;
  void mend_bodies(BodyMasses& masses) const;
  void check_bodies(const BodyMasses& masses) const;

  Axis up_axis_;
  int32_t current_world_ = -1;
  std::vector<Vec3f> world_gravity_;  // one per world
  std::vector<Body> bodies_;
  std::vector<Shape> shapes_;
  std::vector<Joint> joints_;
  std::vector<Articulation> articulations_;
  ActuatorList actuators_;
  std::vector<std::string> refused_;  // by finalize
  Springs springs_;
  Triangles triangles_;
  Edges edges_;
  Tetrahedra tetrahedra_;
  std::set<std::pair<int32_t, int32_t>> filter_pairs_;
  std::unordered_multimap<size_t, std::shared_ptr<const Mesh>> meshes_;  // by a hash
  std::vector<int32_t> colors_;  // of the first particles; empty: not colored
  // Which elements must have corners of different colors.
  enum class ColorCheck : uint8_t { None, WithoutBending, All } color_check_ = ColorCheck::All;
};

// The shape pairs (i < j, lexicographic) that may touch: both collide with shapes, worlds and
// groups meet, not on one body, not both world-owned, not filtered. `body` -1 is the world. All
// spans have one row per shape.
NOVAPHY_CORE_API std::vector<Vec2i> make_shape_contact_pairs(
    std::span<const int32_t> body, std::span<const int32_t> flags,
    std::span<const int32_t> collision_group, std::span<const int32_t> world,
    const std::set<std::pair<int32_t, int32_t>>& filter_pairs);

}  // namespace novaphy
