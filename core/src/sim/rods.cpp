#include "novaphy/core/sim/rods.h"

#include <algorithm>
#include <cmath>
#include <string_view>

#include "builder_checks.h"
#include "mass_properties.h"
#include "novaphy/core/error.h"
#include "novaphy/math/functions.h"

namespace novaphy {
namespace {

constexpr Vec3f kAlong = {0.0f, 0.0f, 1.0f};  // the direction of a link in its own frame

// A link of a rod: an edge, its length (m) and its pose in the world.
struct RodLink {
  Vec2i ends{};
  float length = 0.0f;
  Transformf pose = Transformf::identity();
  int32_t shape = -1;

  int32_t other(int32_t node) const { return ends.x == node ? ends.y : ends.x; }
  Vec3f end(int32_t node) const { return kAlong * (node == ends.x ? -0.5f : 0.5f) * length; }
};

// Returns the shortest rotation from z to a unit vector.
Quatf along(const Vec3f& t) {
  if (t.z < -0.999999f) return {1.0f, 0.0f, 0.0f, 0.0f};
  const float w = math::sqrt(0.5f * (1.0f + t.z)), s = 0.5f / w;
  return {-t.y * s, t.x * s, 0.0f, w};
}

// Returns the material with its defaults of shear and twist.
RodMaterial resolved(RodMaterial m) {
  m.shear_stiffness = m.shear_stiffness.value_or(m.stretch_stiffness);
  m.shear_damping = m.shear_damping.value_or(m.stretch_damping);
  m.twist_stiffness = m.twist_stiffness.value_or(m.bend_stiffness);
  m.twist_damping = m.twist_damping.value_or(m.bend_damping);
  return m;
}

void check_material(std::string_view name, const RodMaterial& m) {
  detail::check_not_negative({name, "stretch_stiffness"}, m.stretch_stiffness);
  detail::check_not_negative({name, "stretch_damping"}, m.stretch_damping);
  detail::check_not_negative({name, "bend_stiffness"}, m.bend_stiffness);
  detail::check_not_negative({name, "bend_damping"}, m.bend_damping);
  detail::check_not_negative({name, "shear_stiffness"}, m.shear_stiffness.value_or(0.0f));
  detail::check_not_negative({name, "shear_damping"}, m.shear_damping.value_or(0.0f));
  detail::check_not_negative({name, "twist_stiffness"}, m.twist_stiffness.value_or(0.0f));
  detail::check_not_negative({name, "twist_damping"}, m.twist_damping.value_or(0.0f));
}

// The names of a function and of its argument for the nodes, for errors.
struct RodNames {
  std::string_view function, nodes;
  bool has_edges = true;  // whether the edges are an argument, too
};
constexpr RodNames kRod = {"add_rod", "positions", false};
constexpr RodNames kGraph = {"add_rod_graph", "node_positions"};

std::vector<RodLink> links_of(const RodNames& names, std::span<const Vec3f> nodes,
                              std::span<const Vec2i> edges, const RodArgs& args) {
  const std::string_view name = names.function;
  const auto count = static_cast<int32_t>(nodes.size());
  for (size_t k = 0; k < nodes.size(); ++k)
    detail::check_finite({name, names.nodes, k}, nodes[k]);
  require(!edges.empty(), ErrorKind::Value, name, ": edges: expected at least one, got none");
  require(args.quaternions.empty() || args.quaternions.size() == edges.size(), ErrorKind::Value,
          name, ": quaternions: expected ", edges.size(), ", one for each link, got ",
          args.quaternions.size());
  std::vector<RodLink> links;
  for (size_t k = 0; k < edges.size(); ++k) {
    const detail::Where where{name, "edges", k};
    const auto [a, b] = edges[k];
    require(a >= 0 && b >= 0 && a < count && b < count, ErrorKind::Index, where,
            ": expected nodes from 0 to ", count - 1, ", got ", a, " and ", b);
    const Vec3f way = nodes[static_cast<size_t>(b)] - nodes[static_cast<size_t>(a)];
    const float length = math::length(way);
    require(length > 1e-6f, ErrorKind::Value,
            names.has_edges ? where : detail::Where{name, names.nodes, static_cast<size_t>(b)},
            ": expected more than 1e-6 m between two nodes of a link, got ", length);
    const Vec3f t = way * (1.0f / length);
    RodLink link = {.ends = edges[k], .length = length};
    link.pose = {(nodes[static_cast<size_t>(a)] + nodes[static_cast<size_t>(b)]) * 0.5f, along(t)};
    if (!args.quaternions.empty()) {
      link.pose.q = args.quaternions[k];
      const float off = math::length(math::rotate(link.pose.q, kAlong) - t);
      require(off < 1e-2f, ErrorKind::Value, detail::Where{name, "quaternions", k},
              ": expected a rotation of z to the direction of the link, got one that is ", off,
              " off");
    }
    links.push_back(link);
  }
  return links;
}

// Filters the pairs of link `from` and the links that meet node `at` or lie less than `reach` (m)
// behind it.
void filter_near(ModelBuilder& builder, const std::vector<RodLink>& links,
                 const std::vector<std::vector<size_t>>& of_node, size_t from, int32_t at,
                 float reach) {
  for (const size_t k : of_node[static_cast<size_t>(at)]) {
    if (k == from) continue;
    builder.add_shape_collision_filter_pair(links[from].shape, links[k].shape);
    if (links[k].length < reach)
      filter_near(builder, links, of_node, from, links[k].other(at), reach - links[k].length);
  }
}

// Adds the body of a link, with the mass of a cylinder.
int32_t add_link(ModelBuilder& builder, const RodNames& names, RodLink& link, const RodArgs& args,
                 std::string label) {
  ShapeConfig cfg = args.cfg.value_or(builder.default_shape_cfg);
  const float r = args.radius, half = 0.5f * link.length;
  ShapeConfig solid = cfg;
  solid.is_solid = true;
  const detail::MassProperties of =
      detail::shape_mass(names.function, GeoType::CYLINDER, {r, half, 0.0f}, solid);
  Mat33f inertia{};
  for (int k = 0; k < 3; ++k) inertia.m[k][k] = static_cast<float>(of.inertia.m[k][k]);
  cfg.density = 0.0f;
  const int32_t body = builder.add_body({.xform = link.pose,
                                         .mass = static_cast<float>(of.mass),
                                         .inertia = inertia,
                                         .label = label});
  link.shape = builder.add_shape_capsule(
      body, {.radius = r, .half_height = half, .cfg = cfg, .label = label + "_shape"});
  return body;
}

RodMaterial over_length(const RodMaterial& of, float length) {
  const float s = 1.0f / length;
  const RodMaterial m = resolved(of);
  return {.stretch_stiffness = m.stretch_stiffness * s,
          .stretch_damping = m.stretch_damping * s,
          .bend_stiffness = m.bend_stiffness * s,
          .bend_damping = m.bend_damping * s,
          .shear_stiffness = *m.shear_stiffness * s,
          .shear_damping = *m.shear_damping * s,
          .twist_stiffness = *m.twist_stiffness * s,
          .twist_damping = *m.twist_damping * s};
}

}  // namespace

int32_t add_joint_rod(ModelBuilder& builder, int32_t parent, int32_t child,
                      const RodJointArgs& args) {
  check_material("add_joint_rod", args.material);
  const RodMaterial m = resolved(args.material);
  const int32_t joint = builder.add_joint(JointType::ROD, parent, child,
                                          {.parent_xform = args.parent_xform,
                                           .child_xform = args.child_xform,
                                           .collision_filter_parent = args.collision_filter_parent,
                                           .enabled = args.enabled,
                                           .label = args.label});
  const auto put = [](auto last, float stretch, float shear, float bend, float twist) {
    const float values[6] = {shear, shear, stretch, bend, bend, twist};
    std::copy_n(values, 6, last - 6);
  };
  put(builder.joint_target_ke.end(), m.stretch_stiffness, *m.shear_stiffness, m.bend_stiffness,
      *m.twist_stiffness);
  put(builder.joint_target_kd.end(), m.stretch_damping, *m.shear_damping, m.bend_damping,
      *m.twist_damping);
  return joint;
}

namespace {

Rod rod_of(ModelBuilder& builder, const RodNames& names, std::span<const Vec3f> nodes,
           std::span<const Vec2i> edges, const RodArgs& args) {
  detail::check_positive({names.function, "radius"}, args.radius);
  check_material(names.function, args.material);
  std::vector<RodLink> links = links_of(names, nodes, edges, args);
  const std::string label = args.label.empty() ? "rod" : args.label;
  std::vector<std::vector<size_t>> of_node(nodes.size());
  Rod rod;
  for (size_t k = 0; k < links.size(); ++k) {
    const int32_t body = add_link(builder, names, links[k], args, label + "_" + std::to_string(k));
    rod.bodies.push_back(body);
    for (const int32_t node : {links[k].ends.x, links[k].ends.y})
      of_node[static_cast<size_t>(node)].push_back(k);
  }
  for (size_t k = 0; k < links.size(); ++k)
    for (const int32_t node : {links[k].ends.x, links[k].ends.y})
      filter_near(builder, links, of_node, k, node, 4.0f * args.radius);
  for (size_t node = 0; node < nodes.size(); ++node) {
    const auto at = static_cast<int32_t>(node);
    for (size_t k = 1; k < of_node[node].size(); ++k) {
      const size_t of[2] = {of_node[node][0], of_node[node][k]};
      const RodLink &a = links[of[0]], &b = links[of[1]];
      RodJointArgs joint;
      joint.parent_xform.p = a.end(at);
      joint.child_xform = {b.end(at), math::multiply(math::conjugate(b.pose.q), a.pose.q)};
      joint.material = over_length(args.material, 0.5f * (a.length + b.length));
      joint.label = label + "_joint_" + std::to_string(rod.joints.size());
      rod.joints.push_back(add_joint_rod(builder, rod.bodies[of[0]], rod.bodies[of[1]], joint));
    }
  }
  return rod;
}

}  // namespace

Rod add_rod_graph(ModelBuilder& builder, std::span<const Vec3f> nodes, std::span<const Vec2i> edges,
                  const RodArgs& args) {
  return rod_of(builder, kGraph, nodes, edges, args);
}

Rod add_rod(ModelBuilder& builder, std::span<const Vec3f> nodes, bool closed, const RodArgs& args) {
  const size_t least = closed ? 3 : 2;
  require(nodes.size() >= least, ErrorKind::Value, "add_rod: positions: expected at least ", least,
          ", got ", nodes.size());
  std::vector<Vec2i> edges;
  const auto count = static_cast<int32_t>(nodes.size());
  for (int32_t k = 0; k < (closed ? count : count - 1); ++k) edges.push_back({k, (k + 1) % count});
  return rod_of(builder, kRod, nodes, edges, args);
}

}  // namespace novaphy
