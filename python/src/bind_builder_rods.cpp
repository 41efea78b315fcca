// ModelBuilder's rods, and the ROD joint.
#include "convert.h"
#include "novaphy/core/sim/rods.h"

namespace novaphy::python {
namespace {

using Builder = py::class_<ModelBuilder>;

#define NOVAPHY_ROD_NUMBERS(X) \
  X(stretch_stiffness)         \
  X(stretch_damping)           \
  X(shear_stiffness)           \
  X(shear_damping)             \
  X(bend_stiffness)            \
  X(bend_damping)              \
  X(twist_stiffness)           \
  X(twist_damping)
#define NOVAPHY_ROD_PARAMETER(name) , std::optional<float> name
#define NOVAPHY_ROD_ARGUMENT(name) , py::arg(#name) = py::none()
#define NOVAPHY_ROD_SET(name) \
  if (name) material.name = *name;

constexpr char kJointDoc[] =
    R"(Adds a ROD joint, a spring between the two joint frames, and returns its index.

The z axis of the joint frames is along the rod. The joint is at rest where both frames coincide.
The offset u and the rotation vector r from the parent's to the child's frame have the axes of the
parent's frame. The energy of the offset is 1/2 (shear (ux^2 + uy^2) + stretch uz^2). The energy of
the rotation is 1/2 (bend (rx^2 + ry^2) + twist rz^2). Damping acts on the rates of u and r.

parent_xform, child_xform: the poses of the joint frames (m, quaternion xyzw).
stretch_stiffness (1e9), shear_stiffness: N/m. bend_stiffness (0), twist_stiffness: N*m/rad.
stretch_damping (0), shear_damping: N*s/m. bend_damping (0), twist_damping: N*m*s/rad.
None: the number in parentheses. Shear has the default of stretch, and twist that of bend.

Only SolverVBD has this joint. The stiffness is in six rows of model.joint_target_ke: shear x and y,
stretch, bend x and y, twist. The damping is in joint_target_kd.

ValueError: a pose or number is not valid, or the bodies are in two worlds.
IndexError: a body does not exist.)";

constexpr char kRodDoc[] =
    R"(Adds a rod or cable: a capsule between each two successive positions, and ROD joints between
successive capsules. Returns the lists of bodies and joints.

The rod is at rest in this shape. The mass is that of cylinders with the density of cfg: the caps
count only for contacts. Links whose distance along the rod is less than four radii do not collide.

positions: {n, 3} points (m, world frame). A closed rod also has a link from the last to the first.
quaternions: {n - 1, 4} orientation (xyzw) of each capsule, with z along the link; None: any.
radius: m. cfg: the ShapeConfig of the capsules; None: default_shape_cfg.

The stiffness stretch (1e9) and shear is E A and G A of the section (N). The stiffness bend (0) and
twist is E I and G J (N*m^2). The damping has the units N*s and N*m^2*s, and 0 as its default.
None: the number in parentheses. Shear has the default of stretch, and twist that of bend. A joint
has these values over the mean length of its two links, see add_joint_rod.
label: the bodies are label_0, label_1, ...; None: "rod".

ValueError: a number is not valid, or two successive positions coincide.)";

constexpr char kGraphDoc[] =
    R"(Adds rods that share nodes: a capsule for each edge, and ROD joints at each node between the
first capsule of the node and each other one. Returns the lists of bodies and joints.

node_positions: {n, 3} points (m, world frame). edges: {m, 2} indices of nodes.
All other arguments are those of add_rod. The stiffness of a node's joints is that of the section
over the mean length of both links.

ValueError: a number is not valid, or an edge has no length. IndexError: a node does not exist.)";

std::vector<Quatf> quaternions_of(py::handle value) {
  std::vector<Quatf> all;
  if (value.is_none()) return all;
  for (const py::handle row : py::iter(value)) {
    const Vec4f q = to_vec4(row, "quaternions");
    all.push_back({q.x, q.y, q.z, q.w});
  }
  return all;
}

std::vector<Vec2i> edges_of(py::handle value) {
  std::vector<Vec2i> all;
  for (const py::handle row : py::iter(value)) {
    const std::vector<int32_t> ends = to_int_list(row, "edges");
    require(ends.size() == 2, ErrorKind::Value, "edges[", all.size(),
            "]: expected two indices of nodes, got ", ends.size());
    all.push_back({ends[0], ends[1]});
  }
  return all;
}

RodArgs args_of(py::handle quaternions, float radius, const std::optional<ShapeConfig>& cfg,
                const RodMaterial& material, const std::optional<std::string>& label) {
  return {.radius = radius,
          .cfg = cfg,
          .material = material,
          .quaternions = quaternions_of(quaternions),
          .label = label.value_or("")};
}

py::tuple lists_of(const Rod& rod) { return py::make_tuple(rod.bodies, rod.joints); }

}  // namespace

void bind_builder_rods(Builder& c) {
  c.def(
       "add_joint_rod",
       [](ModelBuilder& b, int32_t parent, int32_t child, py::handle parent_xform,
          py::handle child_xform NOVAPHY_ROD_NUMBERS(NOVAPHY_ROD_PARAMETER),
          std::optional<bool> filter, bool enabled, const std::optional<std::string>& label) {
         RodMaterial material;
         NOVAPHY_ROD_NUMBERS(NOVAPHY_ROD_SET)
         return add_joint_rod(b, parent, child,
                              {.parent_xform = to_transform(parent_xform, "parent_xform"),
                               .child_xform = to_transform(child_xform, "child_xform"),
                               .material = material,
                               .collision_filter_parent = filter.value_or(true),
                               .enabled = enabled,
                               .label = label.value_or("")});
       },
       "parent"_a, "child"_a, py::kw_only(), "parent_xform"_a = py::none(),
       "child_xform"_a = py::none() NOVAPHY_ROD_NUMBERS(NOVAPHY_ROD_ARGUMENT),
       "collision_filter_parent"_a = py::none(), "enabled"_a = true, "label"_a = py::none(),
       kJointDoc)
      .def(
          "add_rod",
          [](ModelBuilder& b, py::handle positions, py::handle quaternions, float radius,
             const std::optional<ShapeConfig>& cfg NOVAPHY_ROD_NUMBERS(NOVAPHY_ROD_PARAMETER),
             bool closed, const std::optional<std::string>& label) {
            RodMaterial material;
            NOVAPHY_ROD_NUMBERS(NOVAPHY_ROD_SET)
            return lists_of(add_rod(b, to_vec3_list(positions, "positions"), closed,
                                    args_of(quaternions, radius, cfg, material, label)));
          },
          "positions"_a, "quaternions"_a = py::none(), py::kw_only(), "radius"_a = 0.1f,
          "cfg"_a = py::none() NOVAPHY_ROD_NUMBERS(NOVAPHY_ROD_ARGUMENT), "closed"_a = false,
          "label"_a = py::none(), kRodDoc)
      .def(
          "add_rod_graph",
          [](ModelBuilder& b, py::handle node_positions, py::handle edges, float radius,
             const std::optional<ShapeConfig>& cfg NOVAPHY_ROD_NUMBERS(NOVAPHY_ROD_PARAMETER),
             py::handle quaternions, const std::optional<std::string>& label) {
            RodMaterial material;
            NOVAPHY_ROD_NUMBERS(NOVAPHY_ROD_SET)
            return lists_of(add_rod_graph(b, to_vec3_list(node_positions, "node_positions"),
                                          edges_of(edges),
                                          args_of(quaternions, radius, cfg, material, label)));
          },
          "node_positions"_a, "edges"_a, py::kw_only(), "radius"_a = 0.1f,
          "cfg"_a = py::none() NOVAPHY_ROD_NUMBERS(NOVAPHY_ROD_ARGUMENT),
          "quaternions"_a = py::none(), "label"_a = py::none(), kGraphDoc);
}

}  // namespace novaphy::python
