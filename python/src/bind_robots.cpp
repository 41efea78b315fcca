// ModelBuilder.add_urdf and add_mjcf, and the types of their results.
#include <pybind11/stl/filesystem.h>

#include "convert.h"
#include "doc_robots.h"
#include "novaphy/collision/overlaps.h"
#ifdef NOVAPHY_PYTHON_IO
#include "novaphy/io/robot.h"
#endif

namespace novaphy::python {

#ifdef NOVAPHY_PYTHON_IO
namespace {

py::tuple pose_tuple(const Transformf& x) {
  return py::make_tuple(x.p.x, x.p.y, x.p.z, x.q.x, x.q.y, x.q.z, x.q.w);
}

py::dict sites_dict(const std::map<std::string, RobotSite>& sites) {
  py::dict all;
  for (const auto& [name, site] : sites)
    all[py::str(name)] = py::make_tuple(site.body, pose_tuple(site.pose));
  return all;
}

// Returns the enumerator that a text option names. ErrorKind::Value: an unknown text.
template <class T>
T word(std::string_view function, const char* name, const std::string& given,
       std::initializer_list<std::pair<const char*, T>> words) {
  std::string expected;
  for (const auto& [text, value] : words) {
    if (given == text) return value;
    expected += (expected.empty() ? "\"" : ", \"") + std::string(text) + "\"";
  }
  fail(ErrorKind::Value, function, ": ", name, ": expected one of ", expected, ", got \"", given,
       "\"");
}

std::vector<JointDofConfig> axes_of(const py::dict& joint, const char* name) {
  std::vector<JointDofConfig> axes;
  if (!joint.contains(name) || joint[name].is_none()) return axes;
  for (const py::handle axis : py::iter(joint[name])) {
    require(py::isinstance<JointDofConfig>(axis), ErrorKind::Type, "add_urdf: base_joint: ", name,
            ": expected JointDofConfig objects, got ", type_name(axis));
    axes.push_back(axis.cast<JointDofConfig>());
  }
  return axes;
}

std::optional<BaseJoint> to_base_joint(py::handle value) {
  if (value.is_none()) return std::nullopt;
  require(py::isinstance<py::dict>(value), ErrorKind::Type,
          "add_urdf: base_joint: expected a dict, got ", type_name(value));
  const auto joint = py::reinterpret_borrow<py::dict>(value);
  for (const auto& item : joint) {
    const auto key = py::str(item.first).cast<std::string>();
    require(key == "joint_type" || key == "linear_axes" || key == "angular_axes", ErrorKind::Value,
            "add_urdf: base_joint: expected joint_type, linear_axes and angular_axes, got ", key);
  }
  require(joint.contains("joint_type"), ErrorKind::Value,
          "add_urdf: base_joint: expected a joint_type, got none");
  return BaseJoint{static_cast<JointType>(to_int32(joint["joint_type"], "joint_type")),
                   axes_of(joint, "linear_axes"), axes_of(joint, "angular_axes")};
}

// Returns a str unchanged, or the path of an os.PathLike. ErrorKind::Type: another type.
std::string path_text(py::handle value, std::string_view name, const char* expected) {
  const bool is_path = py::isinstance<py::str>(value) || py::hasattr(value, "__fspath__");
  require(is_path, ErrorKind::Type, name, ": expected ", expected, ", got ", type_name(value));
  if (py::isinstance<py::str>(value)) return value.cast<std::string>();
  return value.cast<std::filesystem::path>().string();
}

std::string source_text(std::string_view function, py::handle source) {
  return path_text(source, std::string(function) + ": source",
                   "a path or the text of the file, str or os.PathLike");
}

std::vector<std::filesystem::path> to_folders(std::string_view function, py::handle value) {
  std::vector<std::filesystem::path> folders;
  if (value.is_none()) return folders;
  const std::string name = std::string(function) + ": package_dirs";
  require(py::isinstance<py::sequence>(value) && !py::isinstance<py::str>(value) &&
              !py::isinstance<py::bytes>(value),
          ErrorKind::Type, name, ": expected a list of folders, got ", type_name(value));
  for (const py::handle folder : py::iter(value)) {
    const std::string which = name + "[" + std::to_string(folders.size()) + "]";
    folders.emplace_back(path_text(folder, which, "a folder, str or os.PathLike"));
  }
  return folders;
}

// Raises Python's OSError if `source` is a path and the file cannot be opened. XML text passes.
void check_opens(const std::string& source) {
  const size_t first = source.find_first_not_of(" \t\r\n");
  if (first == std::string::npos || source[first] == '<' || source.starts_with("\xEF\xBB\xBF") ||
      source.starts_with("package://") || source.find('\0') != std::string::npos ||
      source.size() >= 4096)
    return;
  py::module_::import("builtins").attr("open")(source, "rb").attr("close")();
}

// Replaces the path of a .xacro file by the XML that xacro makes of it, and adds its folder.
void expand_xacro(std::string_view function, std::string& source,
                  std::vector<std::filesystem::path>& folders) {
  const std::filesystem::path path = std::filesystem::absolute(source);
  const py::object found = py::module_::import("importlib.util").attr("find_spec")("xacro");
  require(!found.is_none(), ErrorKind::Value, function, ": ", source,
          ": expected the Python package xacro (pip install xacro), or a URDF file that xacro made "
          "of it");
  try {
    const py::object document = py::module_::import("xacro").attr("process_file")(path.string());
    source = document.attr("toxml")().cast<std::string>();
  } catch (const py::error_already_set& error) {
    fail(ErrorKind::Value, function, ": ", source,
         ": xacro: ", py::str(error.value()).cast<std::string>());
  }
  folders.push_back(path.parent_path());
  folders.push_back(path.parent_path().parent_path());
}

RobotImport with_warnings(RobotImport result) {
  for (const std::string& text : result.warnings)
    if (PyErr_WarnEx(PyExc_UserWarning, text.c_str(), 1) != 0) throw py::error_already_set();
  return result;
}

Unsupported to_unsupported(std::string_view function, const std::string& given) {
  return word<Unsupported>(function, "unsupported", given,
                           {{"error", Unsupported::Error}, {"warn", Unsupported::Warn}});
}

// Suppresses Python's warnings during the lifetime of the object.
struct NoWarnings {
  const py::module_ warnings = py::module_::import("warnings");
  const py::object context = warnings.attr("catch_warnings")();
  NoWarnings() {
    context.attr("__enter__")();
    warnings.attr("simplefilter")("ignore");
  }
  NoWarnings(const NoWarnings&) = delete;
  NoWarnings& operator=(const NoWarnings&) = delete;
  ~NoWarnings() { context.attr("__exit__")(py::none(), py::none(), py::none()); }
};

// Adds a robot by add(builder, alone). With `filter`, pairs of its shapes that overlap in the
// initial pose never collide. The pairs are found in a temporary model that contains only the
// robot.
template <class Add>
RobotImport add_robot(ModelBuilder& builder, bool filter, const Add& add) {
  std::vector<ShapeOverlap> overlaps;
  if (filter) {
    ModelBuilder alone(builder.up_axis());
    alone.default_shape_cfg = builder.default_shape_cfg;
    alone.default_joint_cfg = builder.default_joint_cfg;
    const NoWarnings no_warnings;  // the user's model will give the same warnings
    add(alone, true);
    overlaps = find_overlaps(alone.finalize(Device::cpu()));
  }
  RobotImport result = add(builder, false);
  const auto shape = [&](int32_t k) { return result.shapes[static_cast<size_t>(k)]; };
  for (const ShapeOverlap& o : overlaps)
    builder.add_shape_collision_filter_pair(shape(o.shape0), shape(o.shape1));
  return with_warnings(std::move(result));
}

RobotImport add_urdf_to(
    ModelBuilder& builder, py::handle source, py::handle xform, std::optional<bool> floating,
    py::handle base_joint, int32_t parent_body, float scale, bool hide_visuals,
    bool parse_visuals_as_colliders, py::handle up_axis, bool force_show_colliders,
    bool enable_self_collisions, bool ignore_inertial_definitions,
    const std::optional<std::string>& joint_ordering, bool bodies_follow_joint_ordering,
    bool collapse_fixed_joints, const std::vector<std::string>& links_to_keep,
    std::optional<int32_t> mesh_maxhullvert, const std::string& joint_damping_mode,
    py::handle package_dirs, const std::string& mimic, bool mend_inertias,
    const std::string& unsupported, bool filter_overlaps, bool ignore_zero_effort) {
  constexpr const char* name = "add_urdf";
  std::string text = source_text(name, source);
  check_opens(text);
  std::vector<std::filesystem::path> folders = to_folders(name, package_dirs);
  if (text.ends_with(".xacro")) expand_xacro(name, text, folders);
  UrdfOptions options{
      .xform = to_transform(xform, "xform"),
      .floating = floating,
      .base_joint = to_base_joint(base_joint),
      .parent_body = parent_body,
      .scale = scale,
      .hide_visuals = hide_visuals,
      .parse_visuals_as_colliders = parse_visuals_as_colliders,
      .up_axis = to_axis(up_axis),
      .force_show_colliders = force_show_colliders,
      .enable_self_collisions = enable_self_collisions,
      .ignore_inertial_definitions = ignore_inertial_definitions,
      .joint_ordering = joint_ordering
                            ? word<JointOrdering>(name, "joint_ordering", *joint_ordering,
                                                  {{"dfs", JointOrdering::DepthFirst},
                                                   {"bfs", JointOrdering::BreadthFirst}})
                            : JointOrdering::File,
      .bodies_follow_joint_ordering = bodies_follow_joint_ordering,
      .collapse_fixed_joints = collapse_fixed_joints,
      .links_to_keep = links_to_keep,
      .mesh_maxhullvert = mesh_maxhullvert,
      .joint_damping_mode = word<JointDampingMode>(
          name, "joint_damping_mode", joint_damping_mode,
          {{"passive", JointDampingMode::Passive}, {"drive", JointDampingMode::Drive}}),
      .package_dirs = std::move(folders),
      .mimic = word<MimicMode>(name, "mimic", mimic,
                               {{"follow", MimicMode::Follow},
                                {"refuse", MimicMode::Refuse},
                                {"fixed", MimicMode::Fixed},
                                {"independent", MimicMode::Independent}}),
      .mend_inertias = mend_inertias,
      .ignore_zero_effort = ignore_zero_effort,
      .unsupported = to_unsupported(name, unsupported)};
  return add_robot(builder, filter_overlaps, [&](ModelBuilder& to, bool alone) {
    options.parent_body = alone ? -1 : parent_body;
    return add_urdf(to, text, options);
  });
}

RobotImport add_mjcf_to(ModelBuilder& builder, py::handle source, py::handle xform,
                        bool collapse_fixed_joints, const std::vector<std::string>& links_to_keep,
                        bool enable_self_collisions, py::handle package_dirs,
                        const std::string& unsupported, bool filter_overlaps) {
  constexpr const char* name = "add_mjcf";
  const std::string text = source_text(name, source);
  check_opens(text);
  const MjcfOptions options{.xform = to_transform(xform, "xform"),
                            .collapse_fixed_joints = collapse_fixed_joints,
                            .links_to_keep = links_to_keep,
                            .enable_self_collisions = enable_self_collisions,
                            .package_dirs = to_folders(name, package_dirs),
                            .unsupported = to_unsupported(name, unsupported)};
  return add_robot(builder, filter_overlaps,
                   [&](ModelBuilder& to, bool) { return add_mjcf(to, text, options); });
}

std::string note_text(const RobotNote& note) {
  return note.file + ":" + std::to_string(note.line) + ": " + note.element + ": " + note.text;
}

std::string report_text(const RobotReport& report) {
  std::string text = "read:";
  for (const auto& [kind, count] : report.read) text += " " + std::to_string(count) + " " + kind;
  const auto add = [&](const char* title, const std::vector<RobotNote>& notes) {
    if (notes.empty()) return;
    text += std::string("\n") + title + ":";
    for (const RobotNote& note : notes) text += "\n  " + note_text(note);
  };
  add("mended", report.mended);
  add("left out", report.left_out);
  add("ignored", report.ignored);
  return text;
}

void bind_report(py::module_& io) {
  py::class_<RobotNote>(io, "RobotNote", "A note of the reader on an element of a file.")
      .def_readonly("file", &RobotNote::file, "The file; <text> for XML given as text.")
      .def_readonly("line", &RobotNote::line, "The line of the element.")
      .def_readonly("element", &RobotNote::element, "The element, such as <joint name=\"knee\">.")
      .def_readonly("text", &RobotNote::text, doc::kNoteText)
      .def("__str__", &note_text);
  py::class_<RobotReport>(io, "RobotReport", doc::kReport)
      .def_readonly("read", &RobotReport::read,
                    "A dict from the kind of an element to the number of such elements.")
      .def_readonly("mended", &RobotReport::mended,
                    "RobotNotes on elements whose values the reader corrected.")
      .def_readonly("left_out", &RobotReport::left_out, doc::kLeftOut)
      .def_readonly("ignored", &RobotReport::ignored, doc::kIgnored)
      .def("__str__", &report_text);
}

void bind_parts(py::module_& io) {
  py::class_<RobotPart>(io, "RobotPart",
                        "An equality, tendon, height field or sensor of an MJCF file, with the "
                        "defaults of its class.")
      .def_readonly("kind", &RobotPart::kind, "The element, such as weld.")
      .def_readonly("name", &RobotPart::name, "The name of the element; empty: it has none.")
      .def_readonly("names", &RobotPart::names, "A dict: attribute -> name or keyword.")
      .def_readonly("numbers", &RobotPart::numbers, "A dict: attribute -> list of numbers.")
      .def_readonly("parts", &RobotPart::parts, "The RobotParts along a tendon, in order.");
}

void bind_views(py::class_<RobotImport>& c) {
  c.def_property_readonly(
       "lights", [](const RobotImport& r) { return sites_dict(r.lights); }, doc::kLights)
      .def_property_readonly(
          "cameras",
          [](const RobotImport& r) {
            py::dict cameras;
            for (const auto& [name, of] : r.cameras)
              cameras[py::str(name)] = py::make_tuple(of.at.body, pose_tuple(of.at.pose), of.fovy);
            return cameras;
          },
          doc::kCameras);
}

void bind_result(py::module_& io) {
  bind_report(io);
  bind_parts(io);
  py::class_<RobotKeyframe>(io, "RobotKeyframe", "A keyframe of an MJCF file.")
      .def_readonly("time", &RobotKeyframe::time, "The time (s).")
      .def_readonly("coord", &RobotKeyframe::coord, "The first row of the keyframe in joint_q.")
      .def_readonly("joint_q", &RobotKeyframe::joint_q, "The values of joint_q from row coord on.");
  py::class_<RobotImport> c(io, "RobotImport", "The objects that add_urdf or add_mjcf added.");
  bind_views(c);
  c.def_readonly("links", &RobotImport::links,
                 "A dict: name of a link -> body. A merged link has the body that contains it.")
      .def_readonly("joints", &RobotImport::joints, "A dict: name of a joint -> index; -1: merged.")
      .def_readonly("joint_dofs", &RobotImport::joint_dofs,
                    "A dict: name of a joint -> first row in joint_qd and joint_f; -1: merged.")
      .def_readonly("joint_coords", &RobotImport::joint_coords,
                    "A dict: name of a joint -> first row in joint_q; -1: merged.")
      .def_property_readonly(
          "link_poses",
          [](const RobotImport& r) {
            py::dict poses;
            for (const auto& [name, pose] : r.link_poses) poses[py::str(name)] = pose_tuple(pose);
            return poses;
          },
          doc::kLinkPoses)
      .def_property_readonly(
          "shape_colors",
          [](const RobotImport& r) {
            py::dict colors;
            for (const auto& [shape, rgba] : r.shape_colors)
              colors[py::int_(shape)] = py::make_tuple(rgba.x, rgba.y, rgba.z, rgba.w);
            return colors;
          },
          "A dict: shape -> (r, g, b, a), for the shapes that have a color in the file.")
      .def_readonly("shapes", &RobotImport::shapes, "The shapes, in order.")
      .def_readonly("articulations", &RobotImport::articulations, "The articulations, in order.")
      .def_readonly("actuators", &RobotImport::actuators,
                    "A dict: name of an actuator -> row in Control.ctrl.")
      .def_property_readonly(
          "sites", [](const RobotImport& r) { return sites_dict(r.sites); },
          "A dict: name of a site -> (body, pose in the body (m, xyzw)); body -1: the world.")
      .def_readonly("keyframes", &RobotImport::keyframes, "A dict: name -> RobotKeyframe.")
      .def_readonly("timestep", &RobotImport::timestep,
                    "The time step of the file (s); None: the file has none.")
      .def_readonly(
          "equalities", &RobotImport::equalities,
          "The equalities, as RobotParts. ModelBuilder.finalize raises for active equalities.")
      .def_readonly("tendons", &RobotImport::tendons,
                    "The tendons, as RobotParts. ModelBuilder.finalize raises if one has a force.")
      .def_readonly("height_fields", &RobotImport::height_fields,
                    "The height fields, as RobotParts. ModelBuilder.finalize raises for their "
                    "geoms.")
      .def_readonly("sensors", &RobotImport::sensors,
                    "The sensors, as RobotParts. No solver uses them.")
      .def_readonly("report", &RobotImport::report, "The RobotReport of the reader.")
      .def_readonly("warnings", &RobotImport::warnings,
                    "The texts of the notes in the report, each text once.");
}

}  // namespace
#endif

void bind_robots(py::class_<ModelBuilder>& builder, py::module_& io) {
  constexpr const char* urdf_doc = doc::kAddUrdf;
  constexpr const char* mjcf_doc = doc::kAddMjcf;
#ifdef NOVAPHY_PYTHON_IO
  bind_result(io);
  builder.def("add_urdf", &add_urdf_to, "source"_a, py::kw_only(), "xform"_a = py::none(),
              "floating"_a = py::none(), "base_joint"_a = py::none(), "parent_body"_a = -1,
              "scale"_a = 1.0f, "hide_visuals"_a = false, "parse_visuals_as_colliders"_a = false,
              "up_axis"_a = 2, "force_show_colliders"_a = false, "enable_self_collisions"_a = true,
              "ignore_inertial_definitions"_a = false, "joint_ordering"_a = "dfs",
              "bodies_follow_joint_ordering"_a = true, "collapse_fixed_joints"_a = false,
              "links_to_keep"_a = std::vector<std::string>{}, "mesh_maxhullvert"_a = py::none(),
              "joint_damping_mode"_a = "passive", "package_dirs"_a = py::none(),
              "mimic"_a = "follow", "mend_inertias"_a = true, "unsupported"_a = "error",
              "filter_overlaps"_a = false, "ignore_zero_effort"_a = false, urdf_doc);
  builder.def("add_mjcf", &add_mjcf_to, "source"_a, py::kw_only(), "xform"_a = py::none(),
              "collapse_fixed_joints"_a = false, "links_to_keep"_a = std::vector<std::string>{},
              "enable_self_collisions"_a = true, "package_dirs"_a = py::none(),
              "unsupported"_a = "error", "filter_overlaps"_a = false, mjcf_doc);
#else
  static_cast<void>(io);
  const auto missing = [&](const char* name, const char* doc) {
    builder.def(
        name,
        [name](const ModelBuilder&, const py::args&, const py::kwargs&) {
          throw py::import_error(
              std::string("ModelBuilder.") + name +
              " is not part of this build of NovaPhy: it was configured with NOVAPHY_WITH_IO=OFF. "
              "Build with -DNOVAPHY_WITH_IO=ON -DNOVAPHY_ASSIMP=source -DNOVAPHY_URDFDOM=source, "
              "as the wheels are.");
        },
        doc);
  };
  missing("add_urdf", urdf_doc);
  missing("add_mjcf", mjcf_doc);
#endif
}

}  // namespace novaphy::python
