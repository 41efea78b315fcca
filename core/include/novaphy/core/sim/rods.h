// Elastic rods and cables: a ROD joint between two bodies, and rods of capsules with such joints.
//
// A ROD joint is a spring between its two joint frames, whose z axis is along the rod. Only
// SolverVBD has the joint; its law is in vbd/bodies/joint_law.h. The stiffness of the six degrees
// of freedom is ModelBuilder::joint_target_ke: shear along x and y, stretch along z, bend about x
// and y, twist about z. The damping is joint_target_kd.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "novaphy/core/sim/model_builder.h"

namespace novaphy {

// Stiffness and damping. Of a ROD joint: N/m and N m/rad, N s/m and N m s/rad. Of a rod's section:
// E A and G A (N), E I and G J (N m^2), and the damping N s and N m^2 s.
struct RodMaterial {
  float stretch_stiffness = 1.0e9f, stretch_damping = 0.0f;
  float bend_stiffness = 0.0f, bend_damping = 0.0f;
  // Empty: the value of stretch (shear) or bend (twist).
  std::optional<float> shear_stiffness = {}, shear_damping = {};
  std::optional<float> twist_stiffness = {}, twist_damping = {};
};

// The joint is at rest where both frames coincide.
struct RodJointArgs {
  Transformf parent_xform = Transformf::identity();
  Transformf child_xform = Transformf::identity();
  RodMaterial material = {};
  bool collision_filter_parent = true;
  bool enabled = true;
  std::string label = {};
};

struct RodArgs {
  float radius = 0.1f;                  // m
  std::optional<ShapeConfig> cfg = {};  // of the capsules; empty: default_shape_cfg
  RodMaterial material = {};            // of the section
  std::vector<Quatf> quaternions = {};  // of each link, with z along the link; empty: any
  std::string label = {};               // "rod" when empty
};

// The bodies and the joints of a rod.
struct Rod {
  std::vector<int32_t> bodies = {}, joints = {};
};

// Adds a ROD joint and returns its index. Errors: as for ModelBuilder::add_joint.
NOVAPHY_CORE_API int32_t add_joint_rod(ModelBuilder& builder, int32_t parent, int32_t child,
                                       const RodJointArgs& args = {});

// Adds a rod: a capsule for each edge between two nodes (m, world frame), and ROD joints between
// the capsules of a node. The rod is at rest in this shape. The mass is that of cylinders: the caps
// count only for contacts. Links whose distance along the rod is less than four radii do not
// collide. The stiffness of a joint is that of the section over the mean length of its two links.
// ErrorKind::Value or Index: a number or edge is not valid, or an edge has no length.
NOVAPHY_CORE_API Rod add_rod_graph(ModelBuilder& builder, std::span<const Vec3f> nodes,
                                   std::span<const Vec2i> edges, const RodArgs& args = {});

// Adds a rod through the nodes, in their order. A closed rod also has a link from the last node to
// the first. Errors: as for add_rod_graph.
NOVAPHY_CORE_API Rod add_rod(ModelBuilder& builder, std::span<const Vec3f> nodes, bool closed,
                             const RodArgs& args = {});

}  // namespace novaphy
