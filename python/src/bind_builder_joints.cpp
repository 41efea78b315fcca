// Joints and articulations of ModelBuilder, and JointDofConfig.
#include "doc_builder_joints.h"
#include "novaphy/core/sim/model_builder.h"
#include "pickle.h"

namespace novaphy::python {
namespace {

using Builder = py::class_<ModelBuilder>;

// The numbers of JointDofConfig.
#define NOVAPHY_DOF_NUMBERS(X)                                               \
  X(limit_lower, "The lower limit (m or rad); -1e10: no limit.")             \
  X(limit_upper, "The upper limit (m or rad); 1e10: no limit.")              \
  X(limit_ke, "The stiffness of the limits (N/m or N*m/rad).")               \
  X(limit_kd, "The damping of the limits (N*s/m or N*m*s/rad).")             \
  X(target_q, "The drive's target position (m or rad).")                     \
  X(target_qd, "The drive's target velocity (m/s or rad/s).")                \
  X(target_ke, "The drive's stiffness (N/m or N*m/rad).")                    \
  X(target_kd, "The drive's damping (N*s/m or N*m*s/rad).")                  \
  X(damping, "The passive damping (N*s/m or N*m*s/rad).")                    \
  X(armature, "The rotor inertia, added to the mass matrix (kg or kg*m^2).") \
  X(effort_limit, "The limit of the drive's force (N or N*m).")              \
  X(velocity_limit, "The limit of the rate (m/s or rad/s).")                 \
  X(friction, "The dry friction (N or N*m).")
#define NOVAPHY_PARAMETER(name, doc) , std::optional<float> name
#define NOVAPHY_ARGUMENT(name, doc) , py::arg(#name) = py::none()
#define NOVAPHY_SET(name, doc) \
  if (name) dof.name = *name;

// A vector, or a coordinate axis.
Vec3f to_direction(py::handle value) {
  const bool vector = PySequence_Check(value.ptr()) && !PyUnicode_Check(value.ptr());
  return vector ? to_vec3(value, "axis") : axis_vector(to_axis(value));
}
Quatf to_quat(py::handle value, const char* name) {
  if (value.is_none()) return Quatf::identity();
  const Vec4f q = to_vec4(value, name);
  return {q.x, q.y, q.z, q.w};
}
JointTargetMode to_mode(int32_t mode) { return static_cast<JointTargetMode>(mode); }

std::vector<JointDofConfig> to_axes(py::handle value, const char* name) {
  std::vector<JointDofConfig> axes;
  if (value.is_none()) return axes;
  for (const py::handle axis : py::iter(value)) {
    require(py::isinstance<JointDofConfig>(axis), ErrorKind::Type, name,
            ": expected JointDofConfig objects, got ", type_name(axis));
    axes.push_back(axis.cast<JointDofConfig>());
  }
  return axes;
}

// Returns the arguments that all functions which add a joint share.
JointArgs joint_args(py::handle parent_xform, py::handle child_xform, std::optional<bool> filter,
                     bool enabled, const std::optional<std::string>& label) {
  return {.parent_xform = to_transform(parent_xform, "parent_xform"),
          .child_xform = to_transform(child_xform, "child_xform"),
          .collision_filter_parent = filter.value_or(true),
          .enabled = enabled,
          .label = label.value_or("")};
}

void bind_dof_config(py::module_& m) {
  py::class_<JointDofConfig> c(
      m, "JointDofConfig",
      "The axis, limits and drive of one degree of freedom of a joint. All numbers are finite. All "
      "numbers are >= 0, except the axis, the targets and the limits. Arguments that are None get "
      "the default. The default of the targets is 0. The default of actuator_mode is "
      "POSITION_VELOCITY.");
  c.def(py::init([](py::handle axis NOVAPHY_DOF_NUMBERS(NOVAPHY_PARAMETER),
                    std::optional<int32_t> actuator_mode) {
          JointDofConfig dof;
          if (!axis.is_none()) dof.axis = to_direction(axis);
          NOVAPHY_DOF_NUMBERS(NOVAPHY_SET)
          if (actuator_mode) dof.actuator_mode = to_mode(*actuator_mode);
          return dof;
        }),
        "axis"_a = py::none() NOVAPHY_DOF_NUMBERS(NOVAPHY_ARGUMENT),
        "actuator_mode"_a = py::none());
#define NOVAPHY_MEMBER(name, doc) c.def_readwrite(#name, &JointDofConfig::name, doc);
  NOVAPHY_DOF_NUMBERS(NOVAPHY_MEMBER)
#undef NOVAPHY_MEMBER
  c.def_property(
       "axis", [](const JointDofConfig& dof) { return to_tuple(dof.axis); },
       [](JointDofConfig& dof, py::handle axis) { dof.axis = to_direction(axis); },
       "The axis in the parent's joint frame: an Axis, or a vector whose length is not 0.")
      .def_property(
          "actuator_mode",
          [](const JointDofConfig& dof) { return static_cast<int32_t>(dof.actuator_mode); },
          [](JointDofConfig& dof, int32_t mode) { dof.actuator_mode = to_mode(mode); },
          "The JointTargetMode: whether the drive uses the position target, the velocity target or "
          "both.")
      .def_static(
          "create_unlimited",
          [](py::handle axis) {
            JointDofConfig dof;
            dof.axis = to_direction(axis);
            return dof;
          },
          "axis"_a, "Returns a JointDofConfig for `axis`, without limits and without a drive.");
  add_settings_pickle(c);
}

using AxisJoint = int32_t (ModelBuilder::*)(int32_t, int32_t, const AxisJointArgs&);

void bind_axis_joint(Builder& c, const char* name, AxisJoint add, const char* doc) {
  c.def(
      name,
      [add](ModelBuilder& b, int32_t parent, int32_t child, py::handle parent_xform,
            py::handle child_xform, py::handle axis NOVAPHY_DOF_NUMBERS(NOVAPHY_PARAMETER),
            std::optional<int32_t> actuator_mode, std::optional<bool> filter, bool enabled,
            const std::optional<std::string>& label) {
        JointDofConfig dof = b.default_joint_cfg;
        if (!axis.is_none()) dof.axis = to_direction(axis);
        NOVAPHY_DOF_NUMBERS(NOVAPHY_SET)
        if (actuator_mode) dof.actuator_mode = to_mode(*actuator_mode);
        const JointArgs common = joint_args(parent_xform, child_xform, filter, enabled, label);
        return (b.*add)(parent, child,
                        {.parent_xform = common.parent_xform,
                         .child_xform = common.child_xform,
                         .dof = dof,
                         .collision_filter_parent = common.collision_filter_parent,
                         .enabled = enabled,
                         .label = common.label});
      },
      "parent"_a, "child"_a, py::kw_only(), "parent_xform"_a = py::none(),
      "child_xform"_a = py::none(), "axis"_a = py::none() NOVAPHY_DOF_NUMBERS(NOVAPHY_ARGUMENT),
      "actuator_mode"_a = py::none(), "collision_filter_parent"_a = py::none(), "enabled"_a = true,
      "label"_a = py::none(), doc);
}

void bind_general_joints(Builder& c) {
  c.def(
       "add_joint",
       [](ModelBuilder& b, int32_t type, int32_t parent, int32_t child, py::handle linear_axes,
          py::handle angular_axes, py::handle parent_xform, py::handle child_xform,
          std::optional<bool> filter, bool enabled, const std::optional<std::string>& label) {
         JointArgs args = joint_args(parent_xform, child_xform, filter, enabled, label);
         args.linear_axes = to_axes(linear_axes, "linear_axes");
         args.angular_axes = to_axes(angular_axes, "angular_axes");
         return b.add_joint(static_cast<JointType>(type), parent, child, args);
       },
       "joint_type"_a, "parent"_a, "child"_a, py::kw_only(), "linear_axes"_a = py::none(),
       "angular_axes"_a = py::none(), "parent_xform"_a = py::none(), "child_xform"_a = py::none(),
       "collision_filter_parent"_a = py::none(), "enabled"_a = true, "label"_a = py::none(),
       doc::kAddJoint)
      .def(
          "add_joint_d6",
          [](ModelBuilder& b, int32_t parent, int32_t child, py::handle linear_axes,
             py::handle angular_axes, py::handle parent_xform, py::handle child_xform,
             std::optional<bool> filter, bool enabled, const std::optional<std::string>& label) {
            JointArgs args = joint_args(parent_xform, child_xform, filter, enabled, label);
            args.linear_axes = to_axes(linear_axes, "linear_axes");
            args.angular_axes = to_axes(angular_axes, "angular_axes");
            return b.add_joint_d6(parent, child, args);
          },
          "parent"_a, "child"_a, py::kw_only(), "linear_axes"_a = py::none(),
          "angular_axes"_a = py::none(), "parent_xform"_a = py::none(),
          "child_xform"_a = py::none(), "collision_filter_parent"_a = py::none(),
          "enabled"_a = true, "label"_a = py::none(),
          "Adds a D6 joint and returns its index: translations along linear_axes, then rotations "
          "about angular_axes, which are lists of up to three JointDofConfigs. The rotations are "
          "applied in order, and each axis rotates with the rotations before it.")
      .def(
          "add_joint_fixed",
          [](ModelBuilder& b, int32_t parent, int32_t child, py::handle parent_xform,
             py::handle child_xform, std::optional<bool> filter, bool enabled,
             const std::optional<std::string>& label) {
            return b.add_joint_fixed(parent, child,
                                     joint_args(parent_xform, child_xform, filter, enabled, label));
          },
          "parent"_a, "child"_a, py::kw_only(), "parent_xform"_a = py::none(),
          "child_xform"_a = py::none(), "collision_filter_parent"_a = py::none(),
          "enabled"_a = true, "label"_a = py::none(),
          "Adds a joint that fixes the child to the parent and returns its index. The joint frames "
          "parent_xform and child_xform (m, quaternion xyzw) coincide.");
}

void bind_ball_joint(Builder& c) {
  c.def(
      "add_joint_ball",
      [](ModelBuilder& b, int32_t parent, int32_t child, py::handle parent_xform,
         py::handle child_xform, float armature, float friction, float damping, py::handle target_q,
         float target_ke, float target_kd, float limit_angle, float limit_ke, float limit_kd,
         std::optional<bool> filter, bool enabled, const std::optional<std::string>& label) {
        const JointArgs common = joint_args(parent_xform, child_xform, filter, enabled, label);
        return b.add_joint_ball(parent, child,
                                {.parent_xform = common.parent_xform,
                                 .child_xform = common.child_xform,
                                 .damping = damping,
                                 .armature = armature,
                                 .friction = friction,
                                 .target_q = to_quat(target_q, "target_q"),
                                 .target_ke = target_ke,
                                 .target_kd = target_kd,
                                 .limit_angle = limit_angle,
                                 .limit_ke = limit_ke,
                                 .limit_kd = limit_kd,
                                 .collision_filter_parent = common.collision_filter_parent,
                                 .enabled = enabled,
                                 .label = common.label});
      },
      "parent"_a, "child"_a, py::kw_only(), "parent_xform"_a = py::none(),
      "child_xform"_a = py::none(), "armature"_a = 0.0f, "friction"_a = 0.0f, "damping"_a = 0.0f,
      "target_q"_a = py::none(), "target_ke"_a = 0.0f, "target_kd"_a = 0.0f,
      "limit_angle"_a = kJointUnlimited, "limit_ke"_a = 1.0e4f, "limit_kd"_a = 10.0f,
      "collision_filter_parent"_a = py::none(), "enabled"_a = true, "label"_a = py::none(),
      "Adds a ball joint and returns its index. The origins of the joint frames coincide. armature "
      "(kg*m^2), friction (N*m) and damping (N*m*s/rad) act on each axis. A drive with the gains "
      "target_ke (N*m/rad) and target_kd (N*m*s/rad) rotates the joint to target_q (quaternion "
      "xyzw). Beyond limit_angle (rad), a spring limit_ke (N*m/rad) and a damper limit_kd "
      "(N*m*s/rad) push the rotation back.");
}

void bind_other_joints(Builder& c) {
  c.def(
       "add_joint_free",
       [](ModelBuilder& b, int32_t child, py::handle parent_xform, py::handle child_xform,
          int32_t parent, std::optional<bool> filter, bool enabled,
          const std::optional<std::string>& label) {
         const JointArgs common = joint_args(parent_xform, child_xform, filter, enabled, label);
         return b.add_joint_free(child, {.parent_xform = common.parent_xform,
                                         .child_xform = common.child_xform,
                                         .parent = parent,
                                         .collision_filter_parent = common.collision_filter_parent,
                                         .enabled = enabled,
                                         .label = common.label});
       },
       "child"_a, py::kw_only(), "parent_xform"_a = py::none(), "child_xform"_a = py::none(),
       "parent"_a = -1, "collision_filter_parent"_a = py::none(), "enabled"_a = true,
       "label"_a = py::none(),
       "Adds a FREE joint, which does not constrain the child, and returns its index. The initial "
       "coordinates are those of the child's pose.")
      .def(
          "add_joint_distance",
          [](ModelBuilder& b, int32_t parent, int32_t child, py::handle parent_xform,
             py::handle child_xform, float min_distance, float max_distance, float limit_ke,
             float limit_kd, std::optional<bool> filter, bool enabled,
             const std::optional<std::string>& label) {
            const JointArgs common = joint_args(parent_xform, child_xform, filter, enabled, label);
            return b.add_joint_distance(parent, child,
                                        {.parent_xform = common.parent_xform,
                                         .child_xform = common.child_xform,
                                         .min_distance = min_distance,
                                         .max_distance = max_distance,
                                         .limit_ke = limit_ke,
                                         .limit_kd = limit_kd,
                                         .collision_filter_parent = common.collision_filter_parent,
                                         .enabled = enabled,
                                         .label = common.label});
          },
          "parent"_a, "child"_a, py::kw_only(), "parent_xform"_a = py::none(),
          "child_xform"_a = py::none(), "min_distance"_a = -1.0f, "max_distance"_a = 1.0f,
          "limit_ke"_a = DistanceJointArgs().limit_ke, "limit_kd"_a = DistanceJointArgs().limit_kd,
          "collision_filter_parent"_a = py::none(), "enabled"_a = true, "label"_a = py::none(),
          "Adds a joint that keeps the distance between the origins of the two joint frames from "
          "min_distance to max_distance (m). Returns the index. A negative bound means no limit. "
          "Beyond a bound, a spring limit_ke (N/m) and a damper limit_kd (N*s/m) act.");
}

void bind_planar_joint(Builder& c) {
  using Dof = std::optional<JointDofConfig>;
  c.def(
      "add_joint_planar",
      [](ModelBuilder& b, int32_t parent, int32_t child, py::handle parent_xform,
         py::handle child_xform, py::handle axis, const Dof& x, const Dof& y, const Dof& angle,
         std::optional<bool> filter, bool enabled, const std::optional<std::string>& label) {
        JointArgs args = joint_args(parent_xform, child_xform, filter, enabled, label);
        const JointDofConfig& other = b.default_joint_cfg;
        args.linear_axes = {x.value_or(other), y.value_or(other)};
        args.angular_axes = {angle.value_or(other)};
        const Vec3f normal = axis.is_none() ? axis_vector(Axis::Z) : to_direction(axis);
        return b.add_joint_planar(parent, child, normal, args);
      },
      "parent"_a, "child"_a, py::kw_only(), "parent_xform"_a = py::none(),
      "child_xform"_a = py::none(), "axis"_a = py::none(), "x"_a = py::none(), "y"_a = py::none(),
      "angle"_a = py::none(), "collision_filter_parent"_a = py::none(), "enabled"_a = true,
      "label"_a = py::none(), doc::kAddPlanar);
}

void bind_articulations(Builder& c) {
  c.def(
       "add_articulation",
       [](ModelBuilder& b, py::handle joints, const std::optional<std::string>& label) {
         return b.add_articulation(to_int_list(joints, "joints"), label.value_or(""));
       },
       "joints"_a, py::kw_only(), "label"_a = py::none(),
       "Makes an articulation from joints and returns its index. `joints` are the indices of the "
       "joints, contiguous and increasing, with parents before children. ValueError: the order is "
       "different, two joints have the same child, there is a second root, or a joint belongs to "
       "another articulation or world.")
      .def("add_constraint_mimic", &ModelBuilder::add_constraint_mimic, "joint0"_a, "joint1"_a,
           "coef0"_a = 0.0f, "coef1"_a = 1.0f, doc::kAddMimic)
      .def(
          "collapse_fixed_joints",
          [](ModelBuilder& b, const std::optional<std::vector<std::string>>& joints_to_keep) {
            const CollapsedJoints done =
                b.collapse_fixed_joints(joints_to_keep.value_or(std::vector<std::string>()));
            py::dict bodies, joints, parents, poses;
            for (size_t i = 0; i < done.body_remap.size(); ++i) {
              const bool kept = done.body_remap[i] >= 0;
              if (kept) {
                bodies[py::int_(i)] = done.body_remap[i];
                continue;
              }
              parents[py::int_(i)] = done.body_merged_parent[i];
              const Transformf& x = done.body_merged_transform[i];
              poses[py::int_(i)] = py::make_tuple(x.p.x, x.p.y, x.p.z, x.q.x, x.q.y, x.q.z, x.q.w);
            }
            for (size_t i = 0; i < done.joint_remap.size(); ++i)
              if (done.joint_remap[i] >= 0) joints[py::int_(i)] = done.joint_remap[i];
            return py::dict("body_remap"_a = bodies, "joint_remap"_a = joints,
                            "body_merged_parent"_a = parents, "body_merged_transform"_a = poses);
          },
          "joints_to_keep"_a = py::none(), doc::kCollapse);
}

}  // namespace

void bind_joint_dof_config(py::module_& m) { bind_dof_config(m); }

void bind_builder_joints(Builder& c) {
  c.attr("JointDofConfig") = py::type::of<JointDofConfig>();
  c.def_readwrite("default_joint_cfg", &ModelBuilder::default_joint_cfg,
                  "The JointDofConfig with the defaults of revolute, prismatic and planar joints.")
      .def_property_readonly("joint_count", &ModelBuilder::joint_count, "The number of joints.")
      .def_property_readonly("joint_coord_count", &ModelBuilder::joint_coord_count,
                             "The number of joint coordinates.")
      .def_property_readonly("joint_dof_count", &ModelBuilder::joint_dof_count,
                             "The number of degrees of freedom of joints.")
      .def_property_readonly("articulation_count", &ModelBuilder::articulation_count,
                             "The number of articulations.");
  bind_axis_joint(c, "add_joint_revolute", &ModelBuilder::add_joint_revolute,
                  "Adds a revolute joint and returns its index. The child rotates about `axis` (an "
                  "Axis, or a vector in the joint frame) through the origin of the joint frame. "
                  "For the numbers see JointDofConfig. None: the value of default_joint_cfg.");
  bind_axis_joint(
      c, "add_joint_prismatic", &ModelBuilder::add_joint_prismatic,
      "Adds a prismatic joint and returns its index. The child moves along `axis` (an Axis, or a "
      "vector in the joint frame). For the numbers see JointDofConfig. None: the value of "
      "default_joint_cfg.");
  bind_ball_joint(c);
  bind_other_joints(c);
  bind_general_joints(c);
  bind_planar_joint(c);
  bind_articulations(c);
  bind_builder_actuators(c);
  bind_builder_rods(c);
}

}  // namespace novaphy::python
