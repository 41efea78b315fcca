// Reads an MJCF file into a Robot, and adds the Robot to a builder.
#include "mjcf_attach.h"
#include "mjcf_include.h"
#include "mjcf_start.h"

namespace novaphy {
namespace detail {
namespace {

// Calls visit(element) for the children with a name in all sections with a name.
template <class Visit>
void each(const XmlFile& file, const char* section, const char* name, Visit&& visit) {
  for (const Element* all = file.root().FirstChildElement(section); all != nullptr;
       all = all->NextSiblingElement(section))
    for (const Element* e = all->FirstChildElement(name); e != nullptr;
         e = e->NextSiblingElement(name))
      visit(*e);
}

// Reads <custom><numeric name="init_qpos">: the initial joint coordinates.
void set_start(MjcfContext& context) {
  each(context.file, "custom", "numeric", [&](const Element& e) {
    const char* const name = e.Attribute("name");
    if (name == nullptr || std::string_view(name) != "init_qpos") return;
    const char* const data = e.Attribute("data");
    if (data == nullptr) context.file.refuse(e, "data: missing");
    const std::vector<double> q = coordinates_of(context, e, context.file.parse(e, "data", data));
    if (q.empty()) return context.notes.ignored(e, "init_qpos has another length than qpos");
    size_t at = 0;
    for (RobotJoint& joint : context.robot.joints) {
      if (joint.type == JointType::FREE) {
        joint.parent_pose = {{q[at], q[at + 1], q[at + 2]},
                             {q[at + 3], q[at + 4], q[at + 5], q[at + 6]}};
        at += 7;
        continue;
      }
      joint.start.resize(static_cast<size_t>(joint.coordinates()));
      for (double& start : joint.start) start = q[at++];
    }
  });
}

// Returns a value of <option> that replaces the value of the builder, or nothing. The value of the
// builder is replaced only if the builder is empty and has the default value.
template <class T>
std::optional<T> replaced(MjcfContext& context, const char* what, const T& of_file,
                          const T& of_builder, const T& by_default) {
  const ModelBuilder& b = context.builder;
  if (of_file == of_builder) return {};
  const bool is_new = b.body_count() == 0 && b.shape_count() == 0 && b.particle_count() == 0 &&
                      b.current_world() < 0 && b.world_count() == 0 && of_builder == by_default;
  if (is_new) return of_file;
  for (const Element* e = context.file.root().FirstChildElement("option"); e != nullptr;
       e = e->NextSiblingElement("option"))
    context.notes.ignored(
        *e, std::string(what) + ": that of the builder stays, which was set or is not empty");
  return {};
}

std::optional<Vec3f> gravity_of(MjcfContext& context) {
  const std::optional<Vec3d>& gravity = context.settings.option.gravity;
  if (!gravity) return {};
  return replaced(context, "gravity", to_float(*gravity), context.builder.gravity,
                  Vec3f{0.0f, 0.0f, -9.81f});
}

std::optional<Fluid> fluid_of(MjcfContext& context) {
  const MjcfOption& option = context.settings.option;
  if (!option.has_fluid()) return {};
  return replaced(context, "density, viscosity, wind", option.fluid, context.builder.fluid, Fluid{});
}

void add_keyframes(const MjcfContext& context, const Posed& xform, int32_t coord,
                   RobotImport& result) {
  const XmlFile& file = context.file;
  int32_t index = 0;
  each(file, "keyframe", "key", [&](const Element& e) {
    const char* const name = e.Attribute("name");
    const std::string label = name != nullptr ? name : "key_" + std::to_string(index);
    ++index;
    const char* const qpos = e.Attribute("qpos");
    if (qpos == nullptr) return;
    std::vector<double> q = coordinates_of(context, e, file.parse(e, "qpos", qpos));
    if (q.empty()) file.refuse(e, "qpos: expected as many numbers as the joints have coordinates");
    size_t at = 0;
    for (const RobotJoint& joint : context.robot.joints) {
      if (joint.type == JointType::FREE) {
        const Posed p = math::multiply(xform, Posed{{q[at], q[at + 1], q[at + 2]},
                                                    {q[at + 3], q[at + 4], q[at + 5], q[at + 6]}});
        const double values[] = {p.p.x, p.p.y, p.p.z, p.q.x, p.q.y, p.q.z, p.q.w};
        std::copy(std::begin(values), std::end(values), q.begin() + static_cast<ptrdiff_t>(at));
        at += 7;
      } else {
        at += static_cast<size_t>(joint.coordinates());
      }
    }
    double time[1] = {0.0};
    file.numbers(e, "time", time);
    RobotKeyframe key{static_cast<float>(time[0]), coord, {}};
    for (const double v : q) key.joint_q.push_back(static_cast<float>(v));
    result.keyframes[label] = std::move(key);
  });
}

// Returns a frame of the file, given in a link, as a frame in the body of this link.
RobotSite site_of(const MjcfContext& context, const Posed& xform, const RobotImport& added,
                  const std::pair<int32_t, Posed>& at) {
  if (at.first < 0) return {-1, to_float(math::multiply(xform, at.second))};
  const std::string& link = context.robot.links[static_cast<size_t>(at.first)].name;
  return {added.links.at(link),
          to_float(math::multiply(to_double(added.link_poses.at(link)), at.second))};
}

void add_sites(const MjcfContext& context, const Posed& xform, ModelBuilder& builder,
               RobotImport& result) {
  for (const auto& [name, at] : context.sites) {
    const RobotSite site = result.sites[name] = site_of(context, xform, result, at);
    builder.add_site({.body = site.body,
                      .type = GeoType::SPHERE,
                      .xform = site.pose,
                      .scale = {0.01f, 0.0f, 0.0f},
                      .label = name});
  }
}

void add_views(const MjcfContext& context, const Posed& xform, RobotImport& result) {
  for (const auto& [light, at] : context.lights)
    result.lights[light] = site_of(context, xform, result, at);
  for (const auto& [camera, view] : context.cameras)
    result.cameras[camera] = {site_of(context, xform, result, view.at),
                              static_cast<float>(view.fovy)};
}

void add_actuators(const MjcfContext& context, const Posed& xform, ModelBuilder& builder,
                   RobotImport& result) {
  for (const MjcfActuator& a : context.actuators) {
    int32_t& row = result.actuators[a.args.law.label];
    if (!a.joint.empty()) {
      row = builder.add_actuator(result.joints.at(a.joint), a.args.law);
      continue;
    }
    BodyActuatorArgs args = a.args;
    const RobotSite site = site_of(context, xform, result, a.site),
                    reference = site_of(context, xform, result, a.reference);
    args.frame = site.pose;
    args.reference_body = reference.body;
    args.reference = reference.pose;
    row = builder.add_body_actuator(site.body, args);
  }
}

}  // namespace
}  // namespace detail

RobotImport add_mjcf(ModelBuilder& builder, std::string_view source, const MjcfOptions& options) {
  constexpr std::string_view name = "add_mjcf";
  require(builder.up_axis() == Axis::Z, ErrorKind::Value, name,
          ": expected a builder whose up axis is z, as that of MJCF files");
  detail::XmlFile file(name, detail::read_source(name, source, options.package_dirs), "mujoco");
  detail::include_files(file, options.package_dirs);
  detail::MjcfContext context(builder, file, options);
  if (const char* model = file.root().Attribute("model")) context.robot.name = model;
  detail::read_others(context);
  detail::read_bodies(context);
  detail::mend_masses(context.robot, context.settings.compiler);
  detail::mend_inertias(context.robot, false, [](size_t, const std::string&) {});
  detail::set_inverse_masses(context.robot);
  detail::read_contacts(context);
  detail::read_actuators(context);
  detail::finish_attached(context);
  detail::set_start(context);
  const std::optional<Vec3f> gravity = detail::gravity_of(context);
  const std::optional<Fluid> fluid = detail::fluid_of(context);

  const detail::Posed xform = detail::to_double(options.xform);
  const int32_t coord = builder.joint_coord_count();
  RobotImport result;  // keyframes are read first, because they may throw
  detail::add_keyframes(context, xform, coord, result);
  RobotImport added = detail::emit_robot(builder, context.robot,
                                         {.function = name,
                                          .xform = xform,
                                          .parent_body = -1,
                                          .collapse = options.collapse_fixed_joints,
                                          .self_collisions = options.enable_self_collisions,
                                          .bodies_follow = true,
                                          .ordering = JointOrdering::DepthFirst,
                                          .pairs_of_mujoco = true,
                                          .links_to_keep = options.links_to_keep,
                                          .filter_parent = context.settings.option.parent_filter});
  added.keyframes = std::move(result.keyframes);
  // The hinges and slides of one body become one joint with several degrees of freedom.
  for (const auto& [joint, at] : context.joints) {
    const std::string& whole = context.robot.joints[static_cast<size_t>(at.joint)].name;
    added.joints[joint] = added.joints.at(whole);
    added.joint_dofs[joint] = added.joint_dofs.at(whole) + at.dof;
    added.joint_coords[joint] = added.joint_coords.at(whole) + at.dof;
  }
  detail::add_sites(context, xform, builder, added);
  detail::add_views(context, xform, added);
  detail::add_actuators(context, xform, builder, added);
  if (context.settings.option.timestep)
    added.timestep = static_cast<float>(*context.settings.option.timestep);
  if (gravity) builder.gravity = *gravity;
  if (fluid) builder.fluid = *fluid;
  for (std::string& why : context.refused) builder.refuse_at_finalize(std::move(why));
  added.equalities = std::move(context.equalities);
  added.tendons = std::move(context.tendons);
  added.height_fields = std::move(context.height_fields);
  added.sensors = std::move(context.sensors);
  detail::set_report(added, context.notes.take());
  return added;
}

}  // namespace novaphy
