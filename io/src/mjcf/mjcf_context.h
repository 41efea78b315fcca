// The state that all parts of the MJCF reader share.
#pragma once

#include <set>

#include "mjcf_mesh.h"

namespace novaphy::detail {

// A hinge, slide, ball or free joint of an MJCF file.
struct MjcfJoint {
  const Element* element = nullptr;
  int32_t joint = 0, dof = 0;  // joint of the Robot, and index of the dof in it
  bool is_scalar = false;      // hinge or slide
  bool is_ball = false;
  double stiffness = 0.0, spring_ref = 0.0;
  double spring_damper[2] = {0.0, 0.0};  // time constant (s) and damping ratio, both > 0; zeros if
                                         // not given
  double range[2] = {0.0, 0.0};
  bool is_limited = false;
  // bounds of the sum of the forces of all actuators
  std::optional<std::pair<double, double>> force_range = {};
};

// The objects on which an actuator acts: a joint, or two sites with their links and poses.
struct MjcfActuator {
  std::string joint;  // empty: the actuator acts on links
  std::pair<int32_t, Posed> site = {}, reference = {};
  BodyActuatorArgs args;  // law.axis is the dof of the Robot's joint
};

struct MjcfCamera {
  std::pair<int32_t, Posed> at;  // link, and pose in the link
  double fovy;                   // rad
};

struct MjcfAttached;  // mjcf_attach.h
// The state that a file shares with all files that it attaches.
struct MjcfAttaching {
  std::filesystem::path top = {};  // folder from which models may be read; empty if the XML was
                                   // given as text
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

  // Adds a reason for finalize to throw, or a note if unsupported parts are left out.
  void refuse_at_finalize(const Element& e, const std::string& text) {
    if (options.unsupported == Unsupported::Warn) return notes.left_out(e, text);
    refused.push_back(file.place(e) + ": " + text + " (unsupported=\"warn\" leaves it out)");
  }
  // Returns a name with the prefix and suffix of an attached model.
  std::string named(const std::string& name) const { return prefix + name + suffix; }

  const ModelBuilder& builder;
  const XmlFile& file;
  const MjcfOptions& options;
  Notes notes;
  MjcfSettings settings;
  MjcfDefaults defaults;
  MjcfAssets assets;
  Robot robot = {};
  std::map<std::string, int32_t> bodies = {};  // index of the link of each body
  std::map<std::string, MjcfJoint> joints = {};
  std::vector<std::string> joint_order = {};  // joints in the order of qpos
  std::set<std::string> geoms = {};
  // link, and pose in the link
  std::map<std::string, std::pair<int32_t, Posed>> sites = {}, lights = {};
  std::map<std::string, MjcfCamera> cameras = {};
  std::vector<MjcfActuator> actuators = {};
  std::vector<RobotPart> equalities = {}, tendons = {}, height_fields = {}, sensors = {};
  std::vector<std::string> refused = {};  // reasons for finalize to throw
  // For an attached model: additions to its names, the context of its parent, and whether only a
  // part is attached. Names may be missing if only a part is attached.
  std::string prefix = {}, suffix = {};
  bool is_part = false;
  const MjcfContext* parent = nullptr;
  std::shared_ptr<MjcfAttaching> attaching = {};
  std::vector<std::shared_ptr<MjcfAttached>> attached = {};
};

// Reads <worldbody>: bodies, joints, geoms, sites.
void read_bodies(MjcfContext& context);
// Reads an element with its children and the defaults of its class.
RobotPart read_part(const MjcfContext& context, const Element& e);
RobotPart read_height_field(const MjcfContext& context, const Element& e);
// A <geom>: its shape, and its contribution to the mass of its body.
struct MjcfGeom {
  RobotShape shape;
  double mass = 0.0;
  Vec3d com{};  // m, in the frame of the geom
  Mat33d inertia{};
};
// Reads a geom. If `with_mass` is false, the mass stays 0.
std::optional<MjcfGeom> read_geom(MjcfContext& context, const Element& e,
                                  const std::string& childclass, const std::string& label,
                                  bool with_mass);
// Reads <contact>: pairs and excluded bodies.
void read_contacts(MjcfContext& context);
// Reads <actuator>. Damping ratios depend on masses, so call this after the masses are known.
void read_actuators(MjcfContext& context);
// Reads <equality>, <tendon>, <sensor> and other unsupported sections.
void read_others(MjcfContext& context);
// Returns the coordinates of the Robot's joints, in the Robot's order, from MuJoCo's qpos. Mocap
// bodies have the poses `mocap` (position and quaternion for each body), or the poses of the file.
std::vector<double> coordinates_of(const MjcfContext& context, const Element& e,
                                   std::span<const double> qpos);

}  // namespace novaphy::detail
