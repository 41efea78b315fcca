// Model: the part of a scene that stays the same over time. ModelBuilder::finalize makes a model.
// The sizes are fixed; the values may be edited.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "novaphy/core/sim/actuator_fields.h"
#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/counts.h"
#include "novaphy/core/sim/derived_fields.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/core/sim/fields.h"
#include "novaphy/core/sim/shape_pair_list.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/core/sim/world_settings.h"

namespace novaphy {

// X(name, element type, width, count, unit, frame, doc). The frame "body, or world" is the frame of
// the shape's body. For a world-owned shape the frame is the world. The frame "joint" is the joint
// frame of the parent, X_parent joint_X_p.
//
// This list has the arrays with one number per degree of freedom of a joint. ModelBuilder has lists
// of the same names.
#define NOVAPHY_MODEL_JOINT_DOF_FIELDS(X)                                                         \
  X(joint_qd, float, 1, joint_dof_count, "m/s or rad/s", "joint", "initial joint velocities")     \
  X(joint_f, float, 1, joint_dof_count, "N or N*m", "joint", "initial forces of a control")       \
  X(joint_target_qd, float, 1, joint_dof_count, "m/s or rad/s", "joint",                          \
    "initial velocity targets of a control")                                                      \
  X(joint_act, float, 1, joint_dof_count, "1", "joint", "initial joint_act of a control")         \
  X(joint_armature, float, 1, joint_dof_count, "kg or kg*m^2", "",                                \
    "added to the inertia of the degree of freedom")                                              \
  X(joint_target_ke, float, 1, joint_dof_count, "N/m or N*m/rad", "", "stiffness of the drive")   \
  X(joint_target_kd, float, 1, joint_dof_count, "N*s/m or N*m*s/rad", "", "damping of the drive") \
  X(joint_damping, float, 1, joint_dof_count, "N*s/m or N*m*s/rad", "",                           \
    "damping force per velocity")                                                                 \
  X(joint_friction, float, 1, joint_dof_count, "N or N*m", "", "largest dry friction")            \
  X(joint_limit_lower, float, 1, joint_dof_count, "m or rad", "joint",                            \
    "lower limit; -1e10: none. First row of a DISTANCE joint: the shortest distance")             \
  X(joint_limit_upper, float, 1, joint_dof_count, "m or rad", "joint",                            \
    "upper limit; 1e10: none. First row of a DISTANCE joint: the longest distance")               \
  X(joint_limit_ke, float, 1, joint_dof_count, "N/m or N*m/rad", "", "stiffness of the limits")   \
  X(joint_limit_kd, float, 1, joint_dof_count, "N*s/m or N*m*s/rad", "", "damping of the limits") \
  X(joint_effort_limit, float, 1, joint_dof_count, "N or N*m", "", "largest force of the drive")  \
  X(joint_velocity_limit, float, 1, joint_dof_count, "m/s or rad/s", "", "largest velocity")

#define NOVAPHY_MODEL_JOINT_FIELDS(X)                                                             \
  X(joint_type, int32_t, 1, joint_count, "", "", "JointType")                                     \
  X(joint_parent, int32_t, 1, joint_count, "", "", "parent body; -1: the world")                  \
  X(joint_child, int32_t, 1, joint_count, "", "", "child body")                                   \
  X(joint_X_p, Transformf, 1, joint_count, "m, 1", "body, or world",                              \
    "pose of the joint frame in the parent")                                                      \
  X(joint_X_c, Transformf, 1, joint_count, "m, 1", "body",                                        \
    "pose of the joint frame in the child")                                                       \
  X(joint_dof_dim, Vec2i, 1, joint_count, "", "", "linear and angular degrees of freedom")        \
  X(joint_q_start, int32_t, 1, joint_count + 1, "", "",                                           \
    "first coordinate of the joint; last row: the number of coordinates")                         \
  X(joint_qd_start, int32_t, 1, joint_count + 1, "", "",                                          \
    "first dof of the joint; last row: the number of dofs")                                       \
  X(joint_enabled, uint8_t, 1, joint_count, "", "", "0: the joint exerts no force")               \
  X(joint_articulation, int32_t, 1, joint_count, "", "", "articulation of the joint; -1: none")   \
  X(joint_ancestor, int32_t, 1, joint_count, "", "",                                              \
    "joint whose child is the parent of this joint, in the same articulation; -1: none")          \
  X(joint_world, int32_t, 1, joint_count, "", "", "world of the joint; -1: all worlds")           \
  X(joint_mimic, int32_t, 1, joint_count, "", "", "joint that this joint mimics; -1: none")       \
  X(joint_mimic_coef, Vec2f, 1, joint_count, "m or rad, and their ratio", "joint",                \
    "(a, b) of a mimic joint: its coordinate is a + b times that of the mimicked joint")          \
  X(joint_q, float, 1, joint_coord_count, "m or rad", "joint", "initial joint coordinates, see "  \
    "JointType")                                                                                  \
  X(joint_target_q, float, 1, joint_coord_count, "m or rad", "joint",                             \
    "initial position targets of a control")                                                      \
  X(joint_axis, Vec3f, 1, joint_dof_count, "1", "joint", "unit vector of the degree of freedom")  \
  X(joint_target_mode, int32_t, 1, joint_dof_count, "", "", "JointTargetMode")                    \
  NOVAPHY_MODEL_JOINT_DOF_FIELDS(X)                                                               \
  X(articulation_start, int32_t, 1, articulation_count + 1, "", "",                               \
    "first joint of the articulation; last row: the number of joints")                            \
  X(articulation_end, int32_t, 1, articulation_count, "", "",                                     \
    "index after the last joint of the articulation")

// The arrays that say which joints and articulations exist. These arrays may not change after
// finalize.
#define NOVAPHY_MODEL_STRUCTURE(X) \
  X(joint_type)                    \
  X(joint_parent)                  \
  X(joint_child)                   \
  X(joint_dof_dim)                 \
  X(joint_q_start)                 \
  X(joint_qd_start)                \
  X(joint_articulation)            \
  X(joint_ancestor)                \
  X(joint_world)                   \
  X(joint_mimic)                   \
  X(joint_mimic_coef)              \
  X(actuator_dof)                  \
  X(actuator_body)                 \
  X(actuator_axes)                 \
  X(actuator_state)                \
  X(articulation_start)            \
  X(articulation_end)

#define NOVAPHY_MODEL_FIELDS(X)                                                                   \
  X(particle_q, Vec3f, 1, particle_count, "m", "world", "initial particle positions")             \
  X(particle_qd, Vec3f, 1, particle_count, "m/s", "world", "initial particle velocities")         \
  X(particle_mass, float, 1, particle_count, "kg", "",                                            \
    "particle masses; 0 makes a particle kinematic")                                              \
  X(particle_inv_mass, float, 1, particle_count, "1/kg", "",                                      \
    "1/mass; 0 where the mass is 0: no force, no gravity")                                        \
  X(particle_radius, float, 1, particle_count, "m", "", "particle radii")                         \
  X(particle_flags, int32_t, 1, particle_count, "", "",                                           \
    "ParticleFlags; a particle without ACTIVE does not change")                                   \
  X(particle_world, int32_t, 1, particle_count, "", "", "world of the particle; -1: all worlds")  \
  X(particle_colors, int32_t, 1, particle_count, "", "",                                          \
    "color of the particle, see ModelBuilder::color; -1: none")                                  \
  X(particle_spring_indices, Vec2i, 1, spring_count, "", "", "ends of the springs")               \
  X(particle_spring_rest_length, float, 1, spring_count, "m", "", "length without a force")       \
  X(particle_spring_stiffness, float, 1, spring_count, "N/m", "", "spring stiffness")             \
  X(particle_spring_damping, float, 1, spring_count, "N*s/m", "", "damping along the spring")     \
  X(particle_spring_control, float, 1, spring_count, "1", "", "stored; no force uses it")         \
  X(particle_spring_tension_only, uint8_t, 1, spring_count, "", "",                               \
    "1: a rope, which pulls and never pushes")                                                    \
  X(particle_tri_indices, Vec3i, 1, tri_count, "", "", "corners, counter-clockwise")              \
  X(particle_tri_pose, Mat22f, 1, tri_count, "1/m", "triangle",                                   \
    "inverse of the edges x1 - x0, x2 - x0 at rest, as columns; x along the first edge")          \
  X(particle_tri_area, float, 1, tri_count, "m^2", "", "area at rest")                            \
  X(particle_tri_activation, float, 1, tri_count, "1", "",                                        \
    "added to the relative area; a step uses the activation of its Control, if it has one")       \
  X(particle_tri_material, float, 5, tri_count, "N/m, N/m, N*s/m, N*s^2/m^4, N*s^2/m^4", "",      \
    "ke (membrane), ka (area), kd (damping), drag, lift")                                         \
  X(particle_edge_indices, Vec4i, 1, edge_count, "", "",                                          \
    "two vertices opposite to the bending edge (-1: none), then the ends of the edge")            \
  X(particle_edge_rest_angle, float, 1, edge_count, "rad", "", "angle without a force")           \
  X(particle_edge_rest_length, float, 1, edge_count, "m", "", "length of the edge at rest")       \
  X(particle_edge_material, float, 2, edge_count, "N/m^2, N*s/m^4", "",                           \
    "ke (bending stiffness), kd (damping)")                                                       \
  X(particle_tet_indices, Vec4i, 1, tet_count, "", "", "corners, ordered for a volume > 0")       \
  X(particle_tet_pose, Mat33f, 1, tet_count, "1/m", "world",                                      \
    "inverse of the edges x1 - x0, x2 - x0, x3 - x0 at rest, as columns")                         \
  X(particle_tet_volume, float, 1, tet_count, "m^3", "", "volume at rest")                        \
  X(particle_tet_activation, float, 1, tet_count, "1", "",                                        \
    "added to the relative volume; a step uses the activation of its Control, if it has one")     \
  X(particle_tet_material, float, 3, tet_count, "Pa, Pa, Pa*s", "",                               \
    "k_mu, k_lambda (Lame parameters in SolverVBD, see particle_tet_is_lame), k_damp (damping)")  \
  X(particle_tet_is_lame, int32_t, 1, tet_count, "", "",                                          \
    "1: k_mu and k_lambda are Lame parameters in SolverSemiImplicit, too; 0: Newton's numbers")   \
  X(body_q, Transformf, 1, body_count, "m, 1", "world",                                           \
    "initial poses of the body origins: position, quaternion xyzw")                               \
  X(body_qd, SpatialVectorf, 1, body_count, "m/s, rad/s", "world",                                \
    "initial velocity of the center of mass, then angular velocity")                              \
  X(body_com, Vec3f, 1, body_count, "m", "body", "center of mass")                                \
  X(body_mass, float, 1, body_count, "kg", "", "masses")                                          \
  X(body_inv_mass, float, 1, body_count, "1/kg", "", "1/mass; 0 where the mass is 0")             \
  X(body_inertia, Mat33f, 1, body_count, "kg*m^2", "body",                                        \
    "rotational inertia about the center of mass")                                                \
  X(body_inv_inertia, Mat33f, 1, body_count, "1/(kg*m^2)", "body",                                \
    "inverse of the inertia; 0 where the inertia is 0")                                           \
  X(body_gravcomp, float, 1, body_count, "1", "",                                                 \
    "fraction of the weight that a force at the center of mass cancels")                          \
  X(body_flags, int32_t, 1, body_count, "", "",                                                   \
    "BodyFlags; no force changes the prescribed velocity of a KINEMATIC body")                    \
  X(body_world, int32_t, 1, body_count, "", "", "world of the body; -1: all worlds")              \
  X(shape_body, int32_t, 1, shape_count, "", "",                                                  \
    "body of the shape; -1: the shape belongs to the world and does not move")                    \
  X(shape_transform, Transformf, 1, shape_count, "m, 1", "body, or world",                        \
    "pose of the shape: position, quaternion xyzw")                                               \
  X(shape_type, int32_t, 1, shape_count, "", "", "GeoType")                                       \
  X(shape_scale, Vec3f, 1, shape_count, "m", "shape",                                             \
    "size; its meaning depends on the type, see GeoType")                                         \
  X(shape_flags, int32_t, 1, shape_count, "", "", "ShapeFlags")                                   \
  X(shape_world, int32_t, 1, shape_count, "", "", "world of the shape; -1: all worlds")           \
  X(shape_color, Vec3f, 1, shape_count, "1", "",                                                  \
    "red, green, blue (0 to 1) for viewers; negative: the viewer chooses a color")                \
  X(shape_collision_group, int32_t, 1, shape_count, "", "", "collision group, see ShapeConfig")   \
  X(shape_is_solid, uint8_t, 1, shape_count, "", "", "1 if solid, 0 if a shell")                  \
  X(shape_margin, float, 1, shape_count, "m", "",                                                 \
    "outward offset of the surface for other shapes; for particles it only increases the "        \
    "detection distance")                                                                         \
  X(shape_gap, float, 1, shape_count, "m", "", "detection distance of rigid contacts")            \
  X(shape_material_ke, float, 1, shape_count, "N/m", "", "contact stiffness")                     \
  X(shape_material_kd, float, 1, shape_count, "N*s/m", "", "contact damping")                     \
  X(shape_material_kf, float, 1, shape_count, "N*s/m", "", "friction below the Coulomb limit")    \
  X(shape_material_ka, float, 1, shape_count, "m", "", "adhesion distance of rigid contacts")     \
  X(shape_material_mu, float, 1, shape_count, "1", "", "Coulomb friction")                        \
  X(shape_material_restitution, float, 1, shape_count, "1", "",                                   \
    "ratio of separation speed to approach speed; only for SolverFeatherstone with pgs")          \
  X(shape_material_mu_torsional, float, 1, shape_count, "1", "",                                  \
    "stored; no force uses it")                                            \
  X(shape_material_mu_rolling, float, 1, shape_count, "1", "",                                    \
    "stored; no force uses it")                                              \
  X(shape_mixing, float, 4, shape_count, "1, 1, 1/kg, 1", "",                                     \
    "how two materials combine: priority, weight, inverse mass, replacement of a mu of 0; see "   \
    "ShapeConfig")                                                                                \
  X(shape_collision_radius, float, 1, shape_count, "m", "shape",                                  \
    "radius of a sphere about the shape's origin that contains the shape; 1e6 for an infinite "   \
    "plane")                                                                                      \
  X(shape_aabb_lower, Vec3f, 1, shape_count, "m", "shape",                                        \
    "lower corner of the shape's box, without margin")                                            \
  X(shape_aabb_upper, Vec3f, 1, shape_count, "m", "shape",                                        \
    "upper corner of the shape's box, without margin")                                            \
  X(shape_mesh_range, int32_t, 4, shape_count, "", "",                                            \
    "mesh or hull: first vertex, vertex count, first triangle, triangle count; else 0")           \
  X(mesh_vertices, Vec3f, 1, mesh_vertex_count, "m", "shape",                                     \
    "vertices of meshes and hulls, before shape_scale; shapes with the same mesh share them")     \
  X(mesh_indices, Vec3i, 1, mesh_triangle_count, "", "",                                          \
    "triangles of meshes and hulls, counter-clockwise seen from outside, relative to the first "  \
    "vertex of the mesh")                                                                         \
  NOVAPHY_MODEL_JOINT_FIELDS(X)                                                                   \
  NOVAPHY_MODEL_ACTUATOR_FIELDS(X)                                                                \
  NOVAPHY_MODEL_FLUID_FIELDS(X)                                                                   \
  X(gravity, Vec3f, 1, world_count, "m/s^2", "world",                                             \
    "gravity of every world; world -1 reads the last row")
// clang-format on

NOVAPHY_DECLARE_FIELDS(ModelFields, NOVAPHY_MODEL_FIELDS, ModelCounts)

// X(derived, source, rule): see derived_fields.h.
#define NOVAPHY_DERIVED_MODEL_FIELDS(X)              \
  X(particle_inv_mass, particle_mass, InverseOrZero) \
  X(body_inv_mass, body_mass, InverseOrZero)         \
  X(body_inv_inertia, body_inertia, InverseInertia)

// X(name, default, may be infinite, unit, doc). All numbers are >= 0. Every coefficient of a soft
// contact is the mean of the number here and the number of the shape's material.
#define NOVAPHY_MODEL_NUMBERS(X)                                                                  \
  X(soft_contact_ke, 1.0e3f, false, "N/m", "contact stiffness")                                   \
  X(soft_contact_kd, 10.0f, false, "N*s/m", "contact damping")                                    \
  X(soft_contact_kf, 1.0e3f, false, "N*s/m", "friction below the Coulomb limit")                  \
  X(soft_contact_mu, 0.5f, false, "1", "Coulomb friction")                                        \
  X(soft_contact_restitution, 0.0f, false, "1", "stored, as in Newton; no force uses it")         \
  X(particle_adhesion, 0.0f, false, "m",                                                          \
    "largest distance of two surfaces at which a soft contact acts")                              \
  X(particle_max_velocity, 1.0e5f, true, "m/s", "limit of the speed of particles")                \
  X(particle_max_radius, 0.0f, false, "m", "the largest particle_radius when the model was made")
// clang-format on

// The properties of a number that are known without a model.
struct NumberInfo {
  std::string_view name;
  bool may_be_infinite = false;
  std::string_view unit, doc;
};

struct ModelNumbers {
#define NOVAPHY_NUMBER_MEMBER(name, by_default, infinite, unit, doc) float name = by_default;
  NOVAPHY_MODEL_NUMBERS(NOVAPHY_NUMBER_MEMBER)
#undef NOVAPHY_NUMBER_MEMBER
  // Calls visitor(NumberInfo, number) for each number.
  template <class Visitor>
  void visit_numbers(Visitor&& visitor) const {
#define NOVAPHY_VISIT_NUMBER(name, by_default, infinite, unit, doc) \
  visitor(NumberInfo{#name, infinite, unit, doc}, this->name);
    NOVAPHY_MODEL_NUMBERS(NOVAPHY_VISIT_NUMBER)
#undef NOVAPHY_VISIT_NUMBER
  }
};
// Throws ErrorKind::Value for a number that is NaN, negative, or infinite although it must be
// finite. The message begins with `function` and `object`.
NOVAPHY_CORE_API void check_number(std::string_view function, std::string_view object,
                                   const NumberInfo& info, float value);

// The values of a model besides its arrays. All of them may be edited.
struct ModelSettings : ModelNumbers {
  bool requires_grad = false;            // default for state() and control()
  std::vector<std::string> body_label;   // one per body
  std::vector<std::string> shape_label;  // one per shape
  std::vector<std::string> joint_label, articulation_label, actuator_label;
  int32_t max_joints_per_articulation = 0, max_dofs_per_articulation = 0;
  std::set<std::pair<int32_t, int32_t>>
      shape_collision_filter_pairs;  // pairs (i < j) that never touch
};

class NOVAPHY_CORE_API Model : public ModelFields,
                               public ModelSettings,
                               public std::enable_shared_from_this<Model> {
 public:
  using Fields = ModelFields;

  Model(const Model&) = delete;
  Model& operator=(const Model&) = delete;

  NOVAPHY_MODEL_COUNTS(NOVAPHY_COUNT_GETTER)
  const ModelCounts& counts() const { return counts_; }
  Device device() const { return device_; }
  Axis up_axis() const { return up_axis_; }
  // Returns the id of the model, which no other model of any process has. States, controls and
  // contacts carry the id.
  uint64_t id() const { return id_; }
  // Makes a model filled with zeros, for values that were saved outside of the process. The model
  // takes the id of the saved model, so that saved states belong to it.
  static std::shared_ptr<Model> restore(const ModelCounts& counts, Device device, Axis up_axis,
                                        uint64_t id);

  // Returns a state with the initial values. Empty `requires_grad`: the setting of the model.
  SimState state(std::optional<bool> requires_grad = {}) const;
  Control control(std::optional<bool> requires_grad = {}) const;

  // Returns the shape pairs that may touch. The first call computes the list; the values may be
  // edited. Errors as for ShapePairList::get.
  const DeviceArray<Vec2i>& shape_contact_pairs() const {
    return shape_pair_list_.get(shape_collision_filter_pairs, device_);
  }
  int32_t shape_contact_pair_count() const;
  ShapePairList& shape_pair_list() { return shape_pair_list_; }
  const ShapePairList& shape_pair_list() const { return shape_pair_list_; }

  // Returns the particles of each color, ascending. The result is empty if the builder had no
  // colors. Reads from the device.
  std::vector<std::vector<int32_t>> particle_color_groups() const;

  // Sets gravity (m/s^2) of one world, or of all worlds if `world` is empty. ErrorKind::Value: a
  // number is not finite. ErrorKind::Index: the world does not exist.
  void set_gravity(const Vec3f& value, std::optional<int32_t> world = {});

  // Computes the derived arrays whose source was written since they were computed last. Solvers
  // call this function at the start of a step. A value that a caller assigns to a derived array
  // stays until the source is written.
  void update_derived() const;
  // Computes the derived arrays by derive(rule, source, derived). The function `derive` returns
  // false if the values do not exist yet, because a capture only records the computation. Several
  // threads may call update_derived.
  template <class Derive>
  void update_derived(const Derive& derive) const {
    const auto update = [&](const auto& rule, const Array& source, const Array& derived,
                            DerivedStamp& stamp) {
      if (stamp.matches(source)) [[likely]]
        return;
      const std::lock_guard lock(derived_mutex_);
      if (!stamp.matches(source) && derive(rule, source, derived)) stamp.set(source);
    };
#define NOVAPHY_UPDATE_DERIVED(derived, source, rule) \
  update(rule{}, source, derived, derived_stamps_.derived);
    NOVAPHY_DERIVED_MODEL_FIELDS(NOVAPHY_UPDATE_DERIVED)
#undef NOVAPHY_UPDATE_DERIVED
  }
  // Marks the present values of the derived arrays as up to date. The values stay until their
  // source is written.
  void accept_derived() const;
  // Stores copies of the joints, with which check_structure compares later values.
  void keep_structure();
  // Checks the worlds and the arrays of NOVAPHY_MODEL_STRUCTURE. ErrorKind::Value names the array
  // and the row that changed. A call is cheap if no array was written. Later launches depend on the
  // checked values.
  void check_structure(std::string_view function) const;
  // Checks the world of every row: -1, or a world of the model. ErrorKind::Index names the array
  // and the row.
  void check_worlds(std::string_view function) const;
  // Calls check_number for all numbers. Messages begin with `function`.
  void check_numbers(std::string_view function) const;
  // Says that later launches of this thread have the present numbers of the model as arguments. A
  // replay throws ErrorKind::Runtime if a number has changed since.
  void depend_on_numbers() const;

  std::shared_ptr<Model> clone() const { return to(device_); }
  std::shared_ptr<Model> to(Device device) const;  // a copy with its own id
  // Returns a model that the host can read: a non-owning pointer to this model if it is on the CPU,
  // else a copy.
  std::shared_ptr<const Model> on_host() const;

 private:
  friend class ModelBuilder;
  Model(const ModelCounts& counts, Device device, Axis up_axis);

  struct DerivedStamps {
#define NOVAPHY_DERIVED_STAMP(derived, source, rule) DerivedStamp derived;
    NOVAPHY_DERIVED_MODEL_FIELDS(NOVAPHY_DERIVED_STAMP)
#undef NOVAPHY_DERIVED_STAMP
  };

  struct Structure {
#define NOVAPHY_STRUCTURE_NUMBERS(name) std::vector<int32_t> name;
    NOVAPHY_MODEL_STRUCTURE(NOVAPHY_STRUCTURE_NUMBERS)
#undef NOVAPHY_STRUCTURE_NUMBERS
  };
  struct StructureStamps {
#define NOVAPHY_STRUCTURE_STAMP(name) DerivedStamp name;
    NOVAPHY_MODEL_STRUCTURE(NOVAPHY_STRUCTURE_STAMP)
#undef NOVAPHY_STRUCTURE_STAMP
  };

  ModelCounts counts_;
  Device device_;
  Axis up_axis_ = Axis::Z;
  uint64_t id_ = 0;
  mutable DerivedStamps derived_stamps_;
  ShapePairList shape_pair_list_;
  std::shared_ptr<const Structure> structure_;
  mutable StructureStamps structure_stamps_;
  mutable std::array<DerivedStamp, 3> world_stamps_;  // stamps of the checked arrays of worlds
  mutable std::mutex derived_mutex_;
};

}  // namespace novaphy
