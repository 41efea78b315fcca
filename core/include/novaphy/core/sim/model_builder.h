// ModelBuilder: collects particles, elements, bodies, joints and shapes, and makes a checked Model.
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

// A rigid body. `mass` and `inertia` exclude shapes. Each shape with a density adds its mass and
// inertia, in the order of the calls, and moves the center of mass.
struct BodyArgs {
  Transformf xform = Transformf::identity();  // pose of the body's origin in the world
  Vec3f com{};                                // m, body frame: center of mass without shapes
  float mass = 0.0f;                          // kg
  // kg m^2, about `com`, along the axes of the body. An empty value means a point mass.
  std::optional<Mat33f> inertia = {};
  bool lock_inertia = false;  // shapes add no mass and no inertia
  bool is_kinematic = false;  // keeps moving with its velocity without forces; needs no mass
  float gravcomp = 0.0f;      // fraction of the weight that gravity compensation cancels
  // Axes of the box that a fluid acts on, in the body frame. Empty: the inertia's principal axes.
  std::optional<Quatf> fluid_frame = {};
  std::string label = {};  // "body_<index>" when empty
};

// Options of add_shape_* functions. Empty `cfg`: ModelBuilder::default_shape_cfg. Empty `label`:
// "shape_<index>". `xform`: the pose of the shape in its body, or in the world for body -1.
struct ShapeArgs {
  int32_t body = -1;
  GeoType type = GeoType::NONE;
  Transformf xform = Transformf::identity();
  Vec3f scale{};  // see GeoType
  std::optional<ShapeConfig> cfg = {};
  std::string label = {};
  bool is_static = false;  // adds no mass to its body, even with a density
};
struct ShapePlaneArgs {
  Vec4f plane{0.0f, 0.0f, 1.0f,
              0.0f};  // a*x + b*y + c*z + d = 0, normal (a, b, c): (0, 0, 1, -h) is the plane z = h
  std::optional<Transformf> xform = {};  // overrides `plane`; local +z is the normal
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
// A triangle mesh, counter-clockwise seen from outside. Vertices with exactly the same position are
// joined to one. Vertices without a triangle are left out.
struct ShapeMeshArgs {
  Transformf xform = Transformf::identity();
  std::span<const Vec3f> vertices = {};   // m, before `scale`
  std::span<const int32_t> indices = {};  // 3 per triangle
  Vec3f scale{1.0f, 1.0f, 1.0f};          // > 0
  std::optional<ShapeConfig> cfg = {};
  std::string label = {};
};
// The convex hull of points; see convex_hull (core/geometry/convex_hull.h).
struct ShapeConvexHullArgs {
  Transformf xform = Transformf::identity();
  std::span<const Vec3f> vertices = {};     // m, before `scale`
  Vec3f scale{1.0f, 1.0f, 1.0f};            // > 0
  int32_t max_vertices = kMaxHullVertices;  // of the hull, 4 .. kMaxHullVertices
  std::optional<ShapeConfig> cfg = {};
  std::string label = {};
};

// The options of ModelBuilder::color.
struct ColorArgs {
  // Whether corners of a bending edge differ in color. Empty: if the edge has stiffness or damping.
  // False: corners may share a color, and then a stiff hinge converges badly or not at all.
  std::optional<bool> include_bending = {};
  bool balance_colors = true;  // moves particles until the colors have similar sizes
};

struct FinalizeOptions {
  bool requires_grad = false;
  bool skip_validation = false;  // skips finalize's check of values; sizes are still checked
};

// Every add_* function checks its arguments first. After an error the builder is unchanged.
//   ErrorKind::Value           a number that is not finite, a negative number, an extent that is
//                              not positive, a quaternion without unit length and so on
//   ErrorKind::Index           a body, shape or vertex that does not exist
//   ErrorKind::NotImplemented  a shape type that is not supported
// The length of a quaternion may differ from 1 by up to 1e-3; the builder then normalizes the
// quaternion. A quaternion whose length is 1 up to float rounding keeps its bits.
class NOVAPHY_CORE_API ModelBuilder {
 public:
  explicit ModelBuilder(Axis up_axis = Axis::Z, const GravitySpec& gravity = {});

  Axis up_axis() const { return up_axis_; }
  Vec3f up_vector() const { return axis_vector(up_axis_); }

  // Settings for objects that are added later. `gravity` (m/s^2, world frame) is for worlds without
  // a gravity of their own. begin_world reads it, or finalize if the builder has no worlds.
  Vec3f gravity;
  Fluid fluid;  // read at the same times as gravity
  float default_particle_radius = 0.1f;  // m
  ShapeConfig default_shape_cfg;
  JointDofConfig default_joint_cfg;
  float rigid_gap = 0.1f;  // m, gap of shapes whose ShapeConfig has no gap
  // Corrections of dynamic bodies with a mass, which finalize applies with a warning. A correction
  // adds a multiple of the identity to the inertia. balance_inertia corrects an inertia with one
  // principal moment that exceeds the sum of the other two. If false, such an inertia is an error.
  bool balance_inertia = true;
  std::optional<float> bound_mass = {};     // kg, > 0: smallest mass
  std::optional<float> bound_inertia = {};  // kg m^2, > 0: smallest principal moment
  // Default materials of elements.
  float default_tri_ke = 100.0f, default_tri_ka = 100.0f, default_tri_kd = 10.0f;
  float default_tri_drag = 0.0f, default_tri_lift = 0.0f;
  float default_spring_ke = 100.0f, default_spring_kd = 0.0f;
  float default_edge_ke = 100.0f, default_edge_kd = 0.0f;
  float default_tet_k_mu = 1.0e3f, default_tet_k_lambda = 1.0e3f, default_tet_k_damp = 0.0f;
  float default_tet_density = 1.0f;  // kg/m^3

  // The particles so far. The values may be edited before finalize, which checks them again.
  std::vector<Vec3f> particle_q, particle_qd;  // m, m/s, world
  std::vector<float> particle_mass;            // kg
  std::vector<float> particle_radius;          // m
  std::vector<int32_t> particle_flags;         // ParticleFlags
  std::vector<int32_t> particle_world;         // -1: all worlds

  // Initial poses and velocities of the bodies (see Model::body_q, body_qd), which may be edited.
  std::vector<Transformf> body_q;
  std::vector<SpatialVectorf> body_qd;

  // Values of the joints (see Model), which may be edited. joint_q and joint_target_q have a row
  // per coordinate, the others a row per degree of freedom. Until joint_q and joint_qd of a body
  // from add_body are edited, they follow edits of body_q and body_qd.
  std::vector<float> joint_q, joint_target_q;
  std::vector<int32_t> joint_target_mode;
#define NOVAPHY_BUILDER_LIST(name, ...) std::vector<float> name;
  NOVAPHY_MODEL_JOINT_DOF_FIELDS(NOVAPHY_BUILDER_LIST)
#undef NOVAPHY_BUILDER_LIST

  int32_t world_count() const { return static_cast<int32_t>(world_gravity_.size()); }
  int32_t current_world() const { return current_world_; }  // -1: no world is open
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

  // Adds a particle and returns its index. With `mass` 0 it is kinematic and keeps its velocity.
  int32_t add_particle(const Vec3f& pos, const Vec3f& vel, float mass,
                       std::optional<float> radius = {},
                       int32_t flags = static_cast<int32_t>(ParticleFlags::ACTIVE));
  // Adds particles from equally long lists (ErrorKind::Value). An empty list selects the defaults.
  void add_particles(std::span<const Vec3f> pos, std::span<const Vec3f> vel,
                     std::span<const float> mass, std::span<const float> radius = {},
                     std::span<const int32_t> flags = {});

  // Functions that add elements between existing particles (ErrorKind::Index). The present
  // positions are the rest shape. A degenerate rest shape throws ErrorKind::Value and names the
  // element: an area up to 1e-7 of the longest edge squared, a volume up to 1e-7 of the longest
  // edge cubed, or an inverted tetrahedron. Materials are finite and >= 0.
  //
  // Adds a spring and returns its index. The rest length is the present distance. `control` is only
  // stored. `tension_only` makes a rope: it pulls beyond its rest length and never pushes.
  int32_t add_spring(int32_t i, int32_t j, float ke, float kd, float control = 0.0f,
                     bool tension_only = false);
  // Adds a triangle, counter-clockwise. Returns its area (m^2).
  float add_triangle(int32_t i, int32_t j, int32_t k, const TriMaterial& material = {});
  // Adds several triangles. `materials`: empty, one for all, or one each. Returns the areas (m^2).
  std::vector<float> add_triangles(std::span<const Vec3i> indices,
                                   std::span<const TriMaterial> materials = {});
  // Adds a tetrahedron. The right-hand normal of (i, j, k) points to l. Returns the volume (m^3).
  float add_tetrahedron(int32_t i, int32_t j, int32_t k, int32_t l, std::optional<float> k_mu = {},
                        std::optional<float> k_lambda = {}, std::optional<float> k_damp = {});
  float add_tetrahedron(int32_t i, int32_t j, int32_t k, int32_t l, const TetMaterials& material);
  // Adds tetrahedra. Returns the volumes (m^3).
  std::vector<float> add_tetrahedra(std::span<const Vec4i> indices,
                                    const TetMaterials& materials = {});
  // Adds a bending edge from k to l between triangles (i, k, l) and (j, l, k). i or j = -1 makes a
  // border edge, which has no force. Empty `rest` (rad): the present angle. Returns the index.
  int32_t add_edge(int32_t i, int32_t j, int32_t k, int32_t l, std::optional<float> rest = {},
                   const EdgeMaterial& material = {});
  // Adds bending edges. `rest`: empty or one each. `materials`: empty, one for all, or one each.
  void add_edges(std::span<const Vec4i> indices, std::span<const float> rest = {},
                 std::span<const EdgeMaterial> materials = {});

  // Whole grids and meshes; see element_args.h. ErrorKind::Value: a mesh is empty, has a vertex
  // without an element, or has an edge or face with too many elements.
  void add_particle_grid(const ParticleGridArgs& args);
  void add_cloth_grid(const ClothGridArgs& args);
  void add_cloth_mesh(const ClothMeshArgs& args);
  void add_soft_grid(const SoftGridArgs& args);
  void add_soft_mesh(const SoftMeshArgs& args);

  // Adds a rigid body that moves freely: a link, its FREE joint to the world, and an articulation
  // of the joint. Returns the index. ErrorKind::Value: the mass or inertia is not physical.
  // finalize repeats this check with the mass of the shapes included.
  int32_t add_body(const BodyArgs& args = {});
  // Adds a body without a joint; the mass may be 0. finalize refuses a link without a parent joint.
  int32_t add_link(const BodyArgs& args = {});

  // A joint connects a child to a parent body (-1: the world). Functions return the joint's index.
  // Coordinates start at 0, but FREE and DISTANCE joints start at the present poses of the bodies.
  // Child shapes with ShapeConfig::collision_filter_parent never collide with shapes of the parent.
  //   ErrorKind::Value  bad pose, axis, number or limit order; child = parent; bodies of two worlds
  //   ErrorKind::Index  a body that does not exist
  int32_t add_joint(JointType type, int32_t parent, int32_t child, const JointArgs& args = {});
  int32_t add_joint_revolute(int32_t parent, int32_t child, const AxisJointArgs& args = {});
  int32_t add_joint_prismatic(int32_t parent, int32_t child, const AxisJointArgs& args = {});
  int32_t add_joint_ball(int32_t parent, int32_t child, const BallJointArgs& args = {});
  int32_t add_joint_fixed(int32_t parent, int32_t child, const JointArgs& args = {});
  int32_t add_joint_free(int32_t child, const FreeJointArgs& args = {});
  int32_t add_joint_distance(int32_t parent, int32_t child, const DistanceJointArgs& args = {});
  int32_t add_joint_d6(int32_t parent, int32_t child, const JointArgs& args = {});
  int32_t add_joint_planar(int32_t parent, int32_t child, const Vec3f& axis, JointArgs args = {});
  // Adds a tree of joints and returns the index of the articulation. The indices of `joints` are
  // contiguous and increasing, with the root first and every parent before its children.
  // ErrorKind::Value: another order, a cycle, two joints with the same child, a second root, a
  // joint of another articulation or world, or a kinematic body that is not the child of the root.
  int32_t add_articulation(std::span<const int32_t> joints, std::string label = {});
  // Adds a mimic joint: q0 = coef0 + coef1 q1, in every step of an articulation. Both joints are
  // REVOLUTE or PRISMATIC and belong to the same articulation. Drives, limits, forces and inertia
  // of joint0 act on joint1; the velocity limit of joint0 has no effect. joint1 may itself be a
  // mimic joint. The initial joint_q and joint_qd of joint0 are computed from those of joint1.
  //   ErrorKind::Index  a joint that does not exist
  //   ErrorKind::Value  a joint of another type, a joint0 that is a mimic joint already, a cycle, a
  //                     number that is not finite; from finalize: joints of different articulations
  void add_constraint_mimic(int32_t joint0, int32_t joint1, float coef0 = 0.0f, float coef1 = 1.0f);
  // Adds an actuator of a joint with axes (joint_types.h), or of a body (-1: the world). Returns
  // the index, which is the row of Control::ctrl.
  //   ErrorKind::Index  a joint, axis or body that does not exist
  //   ErrorKind::Value  a joint of another type, a range in the wrong order, a number that is not
  //                     finite, a frame whose quaternion has not length 1, a time constant <= 0
  int32_t add_actuator(int32_t joint, const ActuatorArgs& args = {});
  int32_t add_body_actuator(int32_t body, const BodyActuatorArgs& args = {});
  // Makes finalize throw ErrorKind::NotImplemented. `why` names the feature that solvers lack.
  void refuse_at_finalize(std::string why) { refused_.push_back(std::move(why)); }
  // Merges the child of each enabled FIXED joint into the parent: mass, shapes and joints. A joint
  // is kept if its label is in `keep` or it is a root with several child joints. It is also kept if
  // its child has another parent joint or gravcomp, or is kinematic and its parent is a body.
  CollapsedJoints collapse_fixed_joints(std::span<const std::string> keep = {});

  // Shapes. All functions return the index of the shape. `body` -1 is the world. A plane belongs to
  // the world or to a kinematic body.
  int32_t add_shape(const ShapeArgs& args);
  int32_t add_shape_plane(const ShapePlaneArgs& args = {});
  int32_t add_ground_plane(const GroundArgs& args = {});  // infinite; the normal is the up axis
  int32_t add_shape_sphere(int32_t body, const ShapeSphereArgs& args = {});
  int32_t add_shape_box(int32_t body, const ShapeBoxArgs& args = {});
  int32_t add_shape_capsule(int32_t body, const ShapeCapsuleArgs& args = {});
  int32_t add_shape_cylinder(int32_t body, const ShapeCylinderArgs& args = {});
  int32_t add_shape_cone(int32_t body, const ShapeConeArgs& args = {});
  int32_t add_shape_ellipsoid(int32_t body, const ShapeEllipsoidArgs& args = {});
  // Adds a triangle mesh. A mesh with a density and a body must be closed; see mesh_properties. A
  // hollow mesh has a wall of cfg.margin; see shell_properties (core/geometry/mesh_mass.h).
  // ErrorKind::Value: no triangle, two equal corners of one, a bad index or number, a scale <= 0.
  int32_t add_shape_mesh(int32_t body, const ShapeMeshArgs& args);
  // Adds the convex hull of points. ErrorKind::Value: an error of convex_hull, or a scale <= 0.
  int32_t add_shape_convex_hull(int32_t body, const ShapeConvexHullArgs& args);
  // Adds a named frame: a shape with ShapeFlags::SITE, which collides with nothing and has no mass.
  int32_t add_site(const ShapeArgs& args);

  // Makes two shapes never collide. ErrorKind::Index: no such shape. ErrorKind::Value: a == b.
  void add_shape_collision_filter_pair(int32_t a, int32_t b);

  // Worlds. Everything that is added between begin_world and end_world belongs to one world.
  // Objects of a world interact only with objects of that world and of world -1. Objects outside of
  // begin_world and end_world belong to world -1: all worlds. A model without worlds has one world.
  // begin_world returns the index of the world. Empty `gravity` selects the gravity of the builder.
  // ErrorKind::Runtime: a world is open already (begin_world), or no world is open (end_world).
  // ErrorKind::Value: a number is not finite.
  int32_t begin_world(std::optional<Vec3f> gravity = {});
  void end_world();
  // Adds the objects of another builder to the current world, moved by `xform`. Worlds of the other
  // builder are ignored. Its gravity and fluid become those of this world, or of this builder if no
  // world is open. ErrorKind::Value: another up axis, this builder, a bad pose, too many particles.
  void add_builder(const ModelBuilder& builder, const Transformf& xform = Transformf::identity());
  // Calls begin_world, add_builder and end_world. Returns the index of the world.
  int32_t add_world(const ModelBuilder& builder, const Transformf& xform = Transformf::identity());
  // Calls add_world `world_count` times on a grid along the axes with a nonzero `spacing` (m, world
  // frame). The grid is centered at the origin, but starts at 0 along the up axis.
  void replicate(const ModelBuilder& builder, int32_t world_count, const Vec3f& spacing = {});

  // Colors the particles, so that the particles of one element have different colors. Elements are
  // springs, triangles, tetrahedra, and bending edges with stiffness or damping. SolverVBD moves
  // all particles of a color together. The algorithm is greedy in smallest-last order with ties by
  // index, so the same elements give the same colors. Particles that are added later have no color.
  void color(const ColorArgs& args = {});
  // Sets the colors to given groups of particles. ErrorKind::Value: an empty group, a particle in
  // two groups or in none, or, unless `allow_conflicts`, an element with two corners of one color.
  // ErrorKind::Index: a particle that does not exist.
  void set_coloring(std::span<const std::vector<int32_t>> groups, bool allow_conflicts = false);

  // Checks all objects and makes a model. The builder is unchanged and may be used again.
  // ErrorKind::Runtime: `device` does not exist.
  std::shared_ptr<Model> finalize(Device device = default_device(),
                                  const FinalizeOptions& options = {}) const;

 private:
  // The properties of a body without its shapes, pose and velocity.
  struct Body {
    Vec3f com;
    float mass;
    Mat33f inertia;  // zero for a point mass
    bool lock_inertia;
    bool is_kinematic;
    bool is_link;
    int32_t world;
    std::string label = {};
    float gravcomp = 0.0f;
    std::optional<Quatf> fluid_frame = {};
    int32_t mover = -1;        // joint of an articulation with this body as child; -1: none
    Transformf added_at = {};  // for add_body: the pose that gave the initial joint coordinates
  };
  struct Joint {
    JointType type;
    int32_t parent, child;
    Transformf parent_xform, child_xform;
    int32_t linear, angular;    // degrees of freedom
    int32_t q_start, qd_start;  // first rows in joint_q and joint_qd
    std::vector<Vec3f> axes;    // unit vectors, one per degree of freedom
    bool filter_parent, enabled;
    int32_t articulation = -1;
    std::string label = {};
    int32_t mimic = -1;  // joint that this joint mimics; -1: none
    Vec2f mimic_coef = {};
  };
  struct Articulation {
    int32_t start, end;  // joints [start, end)
    std::string label;
  };
  struct Mesh {
    std::vector<Vec3f> vertices;
    std::vector<Vec3i> triangles;
    bool operator==(const Mesh&) const = default;
  };
  // The arrays of all meshes of the model. Each mesh occurs once, in the order of the shapes.
  struct MeshPool {
    std::vector<Vec3f> vertices;
    std::vector<Vec3i> triangles;
    std::vector<int32_t> ranges;  // 4 numbers per shape
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
    std::shared_ptr<const Mesh> mesh = {};  // for MESH and CONVEX_MESH
    SolidProperties solid = {};             // of the scaled mesh; empty if no mass is needed
  };

  // Elements as one vector per array of the model, with one row per element.
  struct Springs {
    std::vector<Vec2i> indices;
    std::vector<float> rest_length, stiffness, damping, control;
    std::vector<uint8_t> tension_only;
  };
  struct Triangles {
    std::vector<Vec3i> indices;
    std::vector<Mat22f> pose;
    std::vector<float> area, material;  // material: 5 numbers per triangle
  };
  struct Edges {
    std::vector<Vec4i> indices;
    std::vector<float> rest_angle, rest_length, material;  // material: 2 numbers per edge
  };
  struct Tetrahedra {
    std::vector<Vec4i> indices;
    std::vector<Mat33f> pose;
    std::vector<float> volume, material;  // material: 3 numbers per tetrahedron
    std::vector<int32_t> is_lame;
  };
  class Transaction;
  // The mass properties of the bodies with their shapes, one row per body.
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
  int32_t next_coord() const;  // number of coordinates so far
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
  // `mesh`: for MESH and CONVEX_MESH only.
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
  float append_tetrahedron(std::string_view function, const Vec4i& tetrahedron,
                           const TetMaterials& materials, size_t n);
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
  // Calls visit(kind, element, particles) for elements that need different colors; -1: no particle.
  template <class Visit>
  void visit_colored_elements(bool bending, Visit&& visit) const;
  void check_coloring(std::string_view function) const;
  void upload_elements(Model& model) const;
  void upload_bodies(Model& model, const BodyMasses& masses) const;
  void upload_fluid(Model& model, const BodyMasses& masses) const;
  void check_sizes() const;
  void check_values() const;
  void mend_bodies(BodyMasses& masses) const;
  void check_bodies(const BodyMasses& masses) const;

  Axis up_axis_;
  int32_t current_world_ = -1;
  std::vector<Vec3f> world_gravity_;  // one per world
  std::vector<Fluid> world_fluid_;    // one per world
  std::vector<Body> bodies_;
  std::vector<Shape> shapes_;
  std::vector<Joint> joints_;
  std::vector<Articulation> articulations_;
  ActuatorList actuators_;
  std::vector<std::string> refused_;  // reasons for finalize to throw
  Springs springs_;
  Triangles triangles_;
  Edges edges_;
  Tetrahedra tetrahedra_;
  std::set<std::pair<int32_t, int32_t>> filter_pairs_;
  std::unordered_multimap<size_t, std::shared_ptr<const Mesh>> meshes_;  // keyed by a hash
  std::vector<int32_t> colors_;  // one per particle colored so far; empty: not colored
  // The elements whose corners must have different colors.
  enum class ColorCheck : uint8_t { None, WithoutBending, All } color_check_ = ColorCheck::All;
};

// Returns the shape pairs (i < j, in lexicographic order) that may touch. Both shapes collide with
// shapes, their worlds and collision groups are compatible, their bodies differ (-1: world), and
// the pair is not filtered. All spans have one row per shape.
NOVAPHY_CORE_API std::vector<Vec2i> make_shape_contact_pairs(
    std::span<const int32_t> body, std::span<const int32_t> flags,
    std::span<const int32_t> collision_group, std::span<const int32_t> world,
    const std::set<std::pair<int32_t, int32_t>>& filter_pairs);

}  // namespace novaphy
