// Converts the model of urdfdom to a Robot.
#include <cmath>

#include "urdf_check.h"
#include "urdf_mend.h"
#include "urdfdom.h"

namespace novaphy {
namespace detail {
namespace {

Vec3d to_vec(const urdf::Vector3& v) { return {v.x, v.y, v.z}; }

// Converts a pose. The quaternion is normalized, because the rounding of rpy changes its length.
Posed to_pose(const urdf::Pose& pose, double scale) {
  Quatd q = {pose.rotation.x, pose.rotation.y, pose.rotation.z, pose.rotation.w};
  const double norm = std::sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w);
  q = {q.x / norm, q.y / norm, q.z / norm, q.w / norm};
  return {to_vec(pose.position) * scale, q};
}

class Reader {
 public:
  Reader(const ModelBuilder& builder, XmlFile& file, const UrdfOptions& options, Notes& notes)
      : builder_(builder), file_(file), options_(options), notes_(notes), scale_(options.scale) {}

  Robot run() {
    mended_ = mend_urdf(file_, notes_);
    elements_ = check_urdf(file_, notes_);
    const auto model = parse_urdf("add_urdf: " + file_.source().name, file_.text());
    try {
      read(*model);
    } catch (...) {
      take_apart(*model);
      throw;
    }
    take_apart(*model);
    return std::move(robot_);
  }

 private:
  void read(const urdf::ModelInterface& model) {
    robot_.name = model.getName();
    std::map<std::string, int32_t> index;
    for (const std::string& name : elements_.link_order) {
      const Element& e = *elements_.links.at(name);
      const auto link = model.getLink(name);
      if (link == nullptr) file_.refuse(e, "urdfdom left this link out");
      index[name] = static_cast<int32_t>(robot_.links.size());
      robot_.links.push_back(read_link(*link, e));
    }
    add_base(index.at(elements_.root));
    for (const auto& [name, joint] : model.joints_) types_[name] = joint->type;
    for (const std::string& name : elements_.joint_order) {
      const Element& e = *elements_.joints.at(name);
      const auto joint = model.getJoint(name);
      if (joint == nullptr) file_.refuse(e, "urdfdom left this joint out");
      robot_.joints.push_back(read_joint(*joint, e, index));
      warn_of_zero_limits(*joint, e);
    }
    if (options_.mend_inertias)
      mend_inertias(robot_, true, [&](size_t link, const std::string& text) {
        notes_.mended(*elements_.links.at(robot_.links[link].name), text);
      });
    notes_.read("link", static_cast<int32_t>(robot_.links.size()));
    notes_.read("joint", static_cast<int32_t>(elements_.joint_order.size()));
  }

  void add_base(int32_t root) {
    const RobotLink& link = robot_.links[static_cast<size_t>(root)];
    RobotJoint base{.name = link.name + "_base_joint",
                    .where = link.where,
                    .type = JointType::FIXED,
                    .parent = kWorldLink,
                    .child = root,
                    .parent_pose = identity_pose(),
                    .child_pose = identity_pose()};
    if (elements_.joints.contains(base.name)) base.name += "_";
    if (options_.base_joint) {
      base.type = options_.base_joint->type;
      base.linear = options_.base_joint->linear_axes;
      base.angular = options_.base_joint->angular_axes;
    } else if (options_.floating.value_or(false)) {
      base.type = JointType::FREE;
    }
    robot_.joints.push_back(base);
  }

  RobotLink read_link(const urdf::Link& link, const Element& e) {
    RobotLink result{.name = link.name, .where = file_.place(e)};
    const bool is_given = link.inertial != nullptr && !options_.ignore_inertial_definitions;
    if (is_given) {
      const urdf::Inertial& inertial = *link.inertial;
      const Posed origin = to_pose(inertial.origin, scale_);
      result.mass = inertial.mass;
      result.com = origin.p;
      const Mat33d inertia = {{{inertial.ixx, inertial.ixy, inertial.ixz},
                               {inertial.ixy, inertial.iyy, inertial.iyz},
                               {inertial.ixz, inertial.iyz, inertial.izz}}};
      const Quatd& q = origin.q;
      result.inertia = q.x == 0.0 && q.y == 0.0 && q.z == 0.0 ? inertia : turned(q, inertia);
      for (auto& row : result.inertia.m)
        for (double& value : row) value *= scale_ * scale_;
    } else if (link.inertial == nullptr && !options_.ignore_inertial_definitions &&
               link.parent_joint != nullptr && link.parent_joint->type != urdf::Joint::FIXED) {
      notes_.mended(e, "it moves and has no <inertial>: its mass is 0");
    }
    read_shapes(link, e, result);
    return result;
  }

  void read_shapes(const urdf::Link& link, const Element& e, RobotLink& to) {
    const bool from_visuals = options_.parse_visuals_as_colliders;
    size_t k = 0;
    const Element* at = e.FirstChildElement("visual");
    bool has_visual = false;
    for (const auto& visual : link.visual_array) {
      const std::string number = std::to_string(k++);
      if (!options_.hide_visuals &&
          add_shape(to, visual->geometry, visual->origin, *at, link.name + "/visual_" + number,
                    false, true, color_of(*visual)))
        has_visual = true;
      if (from_visuals)
        add_shape(to, visual->geometry, visual->origin, *at, link.name + "/collision_" + number,
                  true, options_.force_show_colliders || !has_visual, color_of(*visual));
      at = at->NextSiblingElement("visual");
    }
    if (from_visuals) return;
    k = 0;
    at = e.FirstChildElement("collision");
    for (const auto& collision : link.collision_array) {
      add_shape(to, collision->geometry, collision->origin, *at,
                link.name + "/collision_" + std::to_string(k++), true,
                options_.force_show_colliders || !has_visual, {});
      at = at->NextSiblingElement("collision");
    }
  }

  static std::optional<Vec4f> color_of(const urdf::Visual& visual) {
    if (visual.material == nullptr) return {};
    const urdf::Color& c = visual.material->color;
    const bool is_textured = !visual.material->texture_filename.empty();
    if (is_textured && c.r == 0.0f && c.g == 0.0f && c.b == 0.0f) return {};
    return Vec4f{c.r, c.g, c.b, c.a};
  }

  // Adds a shape to a link. Returns false if the shape is left out.
  bool add_shape(RobotLink& to, const urdf::GeometrySharedPtr& geometry, const urdf::Pose& origin,
                 const Element& e, const std::string& label, bool is_collider, bool is_visible,
                 std::optional<Vec4f> color) {
    const std::string where = file_.place(e);
    require(geometry != nullptr, ErrorKind::Value, "add_urdf: ", where,
            ": urdfdom left its geometry out");
    RobotShape shape{.type = GeoType::NONE,
                     .pose = to_pose(origin, scale_),
                     .scale = {},
                     .cfg = builder_.default_shape_cfg,
                     .label = label,
                     .where = where,
                     .color = color};
    shape.cfg.is_visible = is_visible;
    if (!is_collider) shape.cfg.has_shape_collision = shape.cfg.has_particle_collision = false;
    if (!is_collider || !options_.ignore_inertial_definitions) shape.cfg.density = 0.0f;
    switch (geometry->type) {
      case urdf::Geometry::SPHERE:
        shape.type = GeoType::SPHERE;
        shape.scale = {static_cast<const urdf::Sphere&>(*geometry).radius * scale_, 0.0, 0.0};
        break;
      case urdf::Geometry::BOX:
        shape.type = GeoType::BOX;
        shape.scale = to_vec(static_cast<const urdf::Box&>(*geometry).dim) * (0.5 * scale_);
        break;
      case urdf::Geometry::CYLINDER: {
        const auto& cylinder = static_cast<const urdf::Cylinder&>(*geometry);
        const Element* const element = e.FirstChildElement("geometry")->FirstChildElement();
        shape.type = mended_.capsules.contains(element) ? GeoType::CAPSULE : GeoType::CYLINDER;
        shape.scale = {cylinder.radius * scale_, 0.5 * cylinder.length * scale_, 0.0};
        break;
      }
      case urdf::Geometry::MESH:
        if (!add_mesh(static_cast<const urdf::Mesh&>(*geometry), e, is_collider, shape))
          return false;
        break;
      default:
        fail(ErrorKind::NotImplemented, "add_urdf: ", where, ": a shape that is not read");
    }
    if (!is_collider && !color && shape.surface != nullptr && !shape.surface->colors.empty())
      add_parts(shape, parts_, to.shapes);
    else
      to.shapes.push_back(std::move(shape));
    return true;
  }

  // Adds a mesh to a link. A display mesh that cannot be read is left out without an error.
  bool add_mesh(const urdf::Mesh& mesh, const Element& e, bool is_collider, RobotShape& to) {
    to.type = GeoType::MESH;
    to.scale = to_vec(mesh.scale) * scale_;
    if (is_collider) to.hull_vertices = options_.mesh_maxhullvert;
    try {
      const std::filesystem::path path = resolve_file("add_urdf: " + to.where, mesh.filename,
                                                      file_.source().folder, options_.package_dirs);
      to.surface = surface(path, to.scale);
      if (const auto& c = to.surface->color; c && !to.color)
        to.color = Vec4f{c->x, c->y, c->z, 1.0f};
    } catch (const Error& error) {
      if (is_collider && options_.unsupported == Unsupported::Error) {
        if (std::string_view(error.what()).starts_with("add_urdf: ")) throw;
        file_.refuse(e, error.what(), error.kind());
      }
      notes_.missing(e, std::string("its mesh is left out: ") + error.what());
      return false;
    }
    return true;
  }

  // Returns the mesh of a file, which is read only once. For a mirrored scale, returns mirrored
  // vertices and sets `scale` to 1.
  std::shared_ptr<const Mesh> surface(const std::filesystem::path& path, Vec3d& scale) {
    auto& read = meshes_[path.string()];
    if (read == nullptr)
      read = std::make_shared<const Mesh>(load_mesh(path, {.drop_degenerate = true}));
    if (scale.x > 0.0 && scale.y > 0.0 && scale.z > 0.0) return read;
    Mesh mirrored = *read;
    for (Vec3f& v : mirrored.vertices)
      v = to_float(Vec3d{v.x * scale.x, v.y * scale.y, v.z * scale.z});
    if (scale.x * scale.y * scale.z < 0.0)
      for (size_t k = 0; k + 2 < mirrored.indices.size(); k += 3)
        std::swap(mirrored.indices[k + 1], mirrored.indices[k + 2]);
    scale = {1.0, 1.0, 1.0};
    return std::make_shared<const Mesh>(std::move(mirrored));
  }

  RobotJoint read_joint(const urdf::Joint& joint, const Element& e,
                        const std::map<std::string, int32_t>& index) {
    RobotJoint result{.name = joint.name,
                      .where = file_.place(e),
                      .type = JointType::FIXED,
                      .parent = index.at(joint.parent_link_name),
                      .child = index.at(joint.child_link_name),
                      .parent_pose = to_pose(joint.parent_to_joint_origin_transform, scale_),
                      .child_pose = identity_pose()};
    const bool frozen = joint.mimic != nullptr && options_.mimic == MimicMode::Fixed;
    if (joint.mimic != nullptr && options_.mimic == MimicMode::Refuse)
      file_.refuse(e,
                   "mimic: mimic=\"follow\" makes it follow the other joint, mimic=\"fixed\" holds "
                   "it at its offset, mimic=\"independent\" makes it a joint of its own",
                   ErrorKind::NotImplemented);
    if (joint.mimic != nullptr && options_.mimic == MimicMode::Follow) follow(joint, result);
    const Vec3d given = to_vec(joint.axis);
    const double length = std::sqrt(math::dot(given, given));
    const Vec3d axis = length > 0.0 ? given / length : Vec3d{1.0, 0.0, 0.0};
    const double held = frozen ? joint.mimic->offset : 0.0;
    switch (joint.type) {
      case urdf::Joint::REVOLUTE:
      case urdf::Joint::CONTINUOUS:
        if (frozen) {
          result.parent_pose.q = math::multiply(result.parent_pose.q, turn(axis, held));
          return result;
        }
        result.type = JointType::REVOLUTE;
        result.angular = {dof(joint, axis, 1.0)};
        return result;
      case urdf::Joint::PRISMATIC:
        if (frozen) {
          result.parent_pose = math::multiply(result.parent_pose,
                                              Posed{axis * (held * scale_), {0.0, 0.0, 0.0, 1.0}});
          return result;
        }
        result.type = JointType::PRISMATIC;
        result.linear = {dof(joint, axis, scale_)};
        return result;
      case urdf::Joint::PLANAR: {
        // A planar joint has two translations in the plane, and a rotation about its normal `axis`.
        const Quatd q = turn_from_z(axis);
        result.type = JointType::PLANAR;
        result.linear = {dof(joint, math::rotate(q, Vec3d{1.0, 0.0, 0.0}), scale_),
                         dof(joint, math::rotate(q, Vec3d{0.0, 1.0, 0.0}), scale_)};
        result.angular = {dof(joint, axis, 1.0)};
        return result;
      }
      case urdf::Joint::FLOATING:
        result.type = JointType::FREE;
        return result;
      default:
        return result;
    }
  }

  // Lengths of the file are scaled; angles are not.
  double scale_of(int type) const { return type == urdf::Joint::PRISMATIC ? scale_ : 1.0; }

  void follow(const urdf::Joint& joint, RobotJoint& to) const {
    if (joint.type == urdf::Joint::FIXED) return;
    to.leader = joint.mimic->joint_name;
    const auto leader = types_.find(to.leader);
    const double scale = scale_of(joint.type);
    to.coef0 = joint.mimic->offset * scale;
    to.coef1 = joint.mimic->multiplier * scale /
               scale_of(leader == types_.end() ? joint.type : leader->second);
  }

  // Warns of limits of 0, which files often use for an unknown effort or velocity.
  void warn_of_zero_limits(const urdf::Joint& joint, const Element& e) {
    const bool is_read = robot_.joints.back().type != JointType::FIXED && joint.limits != nullptr;
    if (!is_read) return;
    if (joint.limits->velocity == 0.0)
      notes_.ignored(e, "velocity=\"0\" of its <limit>: it never moves");
    if (joint.limits->effort == 0.0 && options_.ignore_zero_effort)
      notes_.mended(e, "effort=\"0\" of its <limit>: no such limit");
    else if (joint.limits->effort == 0.0)
      notes_.ignored(e, "effort=\"0\" of its <limit>: its drive has no force");
  }

  JointDofConfig dof(const urdf::Joint& joint, const Vec3d& axis, double scale) const {
    JointDofConfig dof = builder_.default_joint_cfg;
    dof.axis = to_float(axis);
    if (joint.limits != nullptr) {
      if (joint.type == urdf::Joint::REVOLUTE || joint.type == urdf::Joint::PRISMATIC) {
        dof.limit_lower = static_cast<float>(joint.limits->lower * scale);
        dof.limit_upper = static_cast<float>(joint.limits->upper * scale);
      }
      if (joint.limits->effort != 0.0 || !options_.ignore_zero_effort)
        dof.effort_limit = static_cast<float>(joint.limits->effort);
      dof.velocity_limit = static_cast<float>(joint.limits->velocity * scale);
    }
    if (joint.mimic != nullptr && options_.mimic == MimicMode::Follow)
      dof.target_ke = dof.target_kd = 0.0f;  // the drive of the leader moves both joints
    if (joint.dynamics != nullptr) {
      const auto damping = static_cast<float>(joint.dynamics->damping);
      (options_.joint_damping_mode == JointDampingMode::Passive ? dof.damping : dof.target_kd) =
          damping;
      dof.friction = static_cast<float>(joint.dynamics->friction);
    }
    return dof;
  }

  const ModelBuilder& builder_;
  XmlFile& file_;
  const UrdfOptions& options_;
  Notes& notes_;
  const double scale_;
  MendedUrdf mended_;
  UrdfElements elements_;
  std::map<std::string, std::shared_ptr<const Mesh>> meshes_;  // by path
  MeshParts parts_;
  std::map<std::string, int> types_;  // types of joints, by name
  Robot robot_;
};

// Returns the rotation from the up axis of the file to the up axis of the builder.
Quatd turn_up(Axis from, Axis to) {
  if (from == to) return {0.0, 0.0, 0.0, 1.0};
  const Vec3f a = axis_vector(from), b = axis_vector(to);
  const Vec3f normal = math::cross(a, b);
  return turn({normal.x, normal.y, normal.z}, 1.5707963267948966);
}

}  // namespace
}  // namespace detail

RobotImport add_urdf(ModelBuilder& builder, std::string_view source, const UrdfOptions& options) {
  constexpr std::string_view name = "add_urdf";
  require(std::isfinite(options.scale) && options.scale > 0.0f, ErrorKind::Value, name,
          ": scale: expected a finite number > 0, got ", options.scale);
  require(!(options.floating && options.base_joint), ErrorKind::Value, name,
          ": floating, base_joint: expected one of them, got both");
  require(options.parent_body >= -1 && options.parent_body < builder.body_count(), ErrorKind::Index,
          name, ": parent_body: expected -1 (the world) to ", builder.body_count() - 1, ", got ",
          options.parent_body);
  require(!(options.parent_body >= 0 && options.floating.value_or(false)), ErrorKind::Value, name,
          ": floating: expected False with a parent_body, got True");
  require(!options.mesh_maxhullvert ||
              (*options.mesh_maxhullvert >= 4 && *options.mesh_maxhullvert <= kMaxHullVertices),
          ErrorKind::Value, name, ": mesh_maxhullvert: expected 4 to ", kMaxHullVertices, ", got ",
          options.mesh_maxhullvert.value_or(0));
  const Quatf& q = options.xform.q;
  const double norm = std::sqrt(static_cast<double>(q.x) * q.x + static_cast<double>(q.y) * q.y +
                                static_cast<double>(q.z) * q.z + static_cast<double>(q.w) * q.w);
  require(std::abs(norm - 1.0) <= 1e-3, ErrorKind::Value, name,
          ": xform.q: expected a quaternion of length 1 (to 1e-3), got one of length ", norm);
  detail::XmlFile file(name, detail::read_source(name, source, options.package_dirs), "robot");
  detail::Notes notes(file, options.unsupported);
  detail::Robot robot = detail::Reader(builder, file, options, notes).run();
  detail::Posed xform = detail::to_double(options.xform);
  xform.q = math::multiply(xform.q, detail::turn_up(options.up_axis, builder.up_axis()));
  RobotImport result = detail::emit_robot(builder, std::move(robot),
                                          {.function = name,
                                           .xform = xform,
                                           .parent_body = options.parent_body,
                                           .collapse = options.collapse_fixed_joints,
                                           .self_collisions = options.enable_self_collisions,
                                           .bodies_follow = options.bodies_follow_joint_ordering,
                                           .ordering = options.joint_ordering,
                                           .pairs_of_mujoco = false,
                                           .links_to_keep = options.links_to_keep});
  detail::set_report(result, notes.take());
  return result;
}

}  // namespace novaphy
