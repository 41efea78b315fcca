// The state that the parts of the MJCF reader share while a file becomes a Robot.
#pragma once

#include <set>

#include "mjcf_mesh.h"

namespace novaphy::detail {

// A hinge, slide, ball or free joint of the file.
struct MjcfJoint {
  const Element* element = nullptr;
  int32_t joint = 0, dof = 0;  // of the Robot, and which of its degrees of freedom
  bool is_scalar = false;      // hinge or slide
  bool is_ball = false;
  double stiffness = 0.0, spring_ref = 0.0;
  double spring_damper[2] = {0.0, 0.0};  // time constant, s, and ratio of damping, above 0; or none
  double range[2] = {0.0, 0.0};
  bool is_limited = false;
  std::optional<std::pair<double, double>> force_range = {};  // of all actuators together
};

// What an actuator pushes: a joint, or two sites of links, each with its pose in the link.
struct MjcfActuator {
  std::string joint;  // empty: links
  std::pair<int32_t, Posed> site = {}, reference = {};
  BodyActuatorArgs args;  // law.axis: in the joint of the Robot
};

struct MjcfCamera {
  std::pair<int32_t, Posed> at;  // in its link
  double fovy;                   // rad
};

struct MjcfAttached;  // mjcf_attach.h
// Of a file and all that it attaches.
struct MjcfAttaching {
  std::filesystem::path top = {};  // in which models may read; empty: XML given as text
  int32_t models = 0;
  size_t bytes = 0;
};

struct MjcfContext {
  MjcfContext(const ModelBuilder& for_builder, const XmlFile& of_file, const MjcfOptions& with)
      : builder(for_builder),
        file(of_file),
        options(with),
        notes(of_file, with.unsupported),
        settings(read_settings(of_file, notes)),
        defaults(of_file),
        assets(of_file, defaults, settings, with.package_dirs, notes) {}

  [[noreturn]] void not_read(const Element& e, const std::string& what) const {
    file.refuse(e, what + " is not read", ErrorKind::NotImplemented);
  }

  // What finalize refuses, unless such parts are left out.
  void refuse_at_finalize(const Element& e, const std::string& text) {
    if (options.unsupported == Unsupported::Warn) return notes.left_out(e, text);
    refused.push_back(file.place(e) + ": " + text + " (unsupported=\"warn\" leaves it out)");
  }
  // A name of the file, of a model that is attached.
  std::string named(const std::string& name) const { return prefix + name + suffix; }

  const ModelBuilder& builder;
  const XmlFile& file;
  const MjcfOptions& options;
  Notes notes;
  MjcfSettings settings;
  MjcfDefaults defaults;
  MjcfAssets assets;
  Robot robot = {};
  std::map<std::string, int32_t> bodies = {};  // links
  std::map<std::string, MjcfJoint> joints = {};
  std::vector<std::string> joint_order = {};  // as in qpos
  std::set<std::string> geoms = {};
  std::map<std::string, std::pair<int32_t, Posed>> sites = {}, lights = {};  // in their links
  std::map<std::string, MjcfCamera> cameras = {};
  std::vector<MjcfActuator> actuators = {};
  std::vector<RobotPart> equalities = {}, tendons = {}, height_fields = {}, sensors = {};
  std::vector<std::string> refused = {};  // by finalize
  // Of a model that is attached: what its names get, by whom, and whether it is a part only, so
  // that names may be missing.
  std::string prefix = {}, suffix = {};
  bool is_part = false;
  const MjcfContext* parent = nullptr;
  std::shared_ptr<MjcfAttaching> attaching = {};
  std::vector<std::shared_ptr<MjcfAttached>> attached = {};
};

// <worldbody>: bodies, joints, geoms, sites.
void read_bodies(MjcfContext& context);
// An element and what is in it, with the defaults of its class.
RobotPart read_part(const MjcfContext& context, const Element& e);
RobotPart read_height_field(const MjcfContext& context, const Element& e);
// A <geom>: its shape, and what it adds to the mass of its body.
struct MjcfGeom {
  RobotShape shape;
  double mass = 0.0;
  Vec3d com{};  // in the frame of the geom
  Mat33d inertia{};
};
// `with_mass`: else the mass stays 0.
std::optional<MjcfGeom> read_geom(MjcfContext& context, const Element& e,
                                  const std::string& childclass, const std::string& label,
                                  bool with_mass);
// <contact>: pairs and excluded bodies.
void read_contacts(MjcfContext& context);
// <actuator>; after the masses, which damping ratios need.
void read_actuators(MjcfContext& context);
// <equality>, <tendon>, <sensor> and what else has no counterpart.
void read_others(MjcfContext& context);
// The coordinates of the Robot's joints, in its order, from qpos; mocap bodies have the poses
// `mocap`, position and quaternion each, or those of the file.
std::vector<double> coordinates_of(const MjcfContext& context, const Element& e,
                                   std::span<const double> qpos);

}  // namespace novaphy::detail
