// Whole meshes: cloth from triangles, soft bodies from tetrahedra.
#include <algorithm>
#include <cmath>

#include "builder_checks.h"
#include "builder_transaction.h"
#include "mesh_topology.h"
#include "novaphy/core/error.h"

namespace novaphy {
namespace {

// Checks the indices of a mesh, `width` per element. Every vertex must belong to an element.
void check_mesh(std::string_view function, std::span<const Vec3f> vertices,
                std::span<const int32_t> indices, size_t width, const char* elements) {
  require(!vertices.empty(), ErrorKind::Value, function, ": vertices: expected at least one, got ",
          "an empty mesh");
  require(!indices.empty() && indices.size() % width == 0, ErrorKind::Value, function,
          ": indices: expected ", width, " for each of at least one ", elements, ", got ",
          indices.size());
  std::vector<bool> used(vertices.size(), false);
  for (size_t n = 0; n < indices.size(); ++n) {
    const int32_t v = indices[n];
    require(v >= 0 && static_cast<size_t>(v) < vertices.size(), ErrorKind::Index, function,
            ": indices[", n, "] (", elements, " ", n / width, "): expected 0 to ",
            vertices.size() - 1, ", got ", v);
    used[static_cast<size_t>(v)] = true;
  }
  const auto loose = std::find(used.begin(), used.end(), false);
  require(loose == used.end(), ErrorKind::Value, function, ": vertices[", loose - used.begin(),
          "]: expected a vertex that a ", elements, " uses, got a loose one, which has no mass");
}

}  // namespace

int32_t ModelBuilder::append_vertices(std::string_view function, const Placement& placement,
                                      double scale, std::span<const Vec3f> vertices,
                                      std::optional<float> radius) {
  detail::check_finite({function, "pos"}, placement.pos);
  detail::check_finite({function, "vel"}, placement.vel);
  require(std::isfinite(scale) && scale > 0.0, ErrorKind::Value, function,
          ": scale: expected a finite number > 0, got ", scale);
  const float r = radius.value_or(default_particle_radius);
  detail::check_not_negative({function, radius ? "particle_radius" : "default_particle_radius"}, r);
  const Quatf rot = detail::checked_pose(function, {placement.pos, placement.rot}).q;
  const auto s = static_cast<float>(scale);
  const int32_t first = particle_count();
  for (size_t n = 0; n < vertices.size(); ++n) {
    detail::check_finite({function, "vertices", n}, vertices[n]);
    add_particle(math::rotate(rot, vertices[n] * s) + placement.pos, placement.vel, 0.0f, r);
  }
  return first;
}

void ModelBuilder::append_cloth(std::string_view name, const ClothMeshArgs& args) {
  check_mesh(name, args.vertices, args.indices, 3, "triangle");
  require(std::isfinite(args.density) && args.density >= 0.0, ErrorKind::Value, name,
          ": density: expected a finite number >= 0, got ", args.density);
  const int32_t first =
      append_vertices(name, args.placement, args.scale, args.vertices, args.particle_radius);
  std::vector<Vec3i> triangles;
  const auto density = static_cast<float>(args.density);
  for (size_t n = 0; n < args.indices.size(); n += 3) {
    const Vec3i t = {first + args.indices[n], first + args.indices[n + 1],
                     first + args.indices[n + 2]};
    const float mass = density * append_triangle(name, t, args.tri) / 3.0f;
    for (const int32_t corner : {t.x, t.y, t.z}) particle_mass[static_cast<size_t>(corner)] += mass;
    triangles.push_back(t);
  }
  const std::vector<Vec4i> edges = detail::edges_of(triangles, name, ": expected a manifold mesh");
  for (const Vec4i& edge : edges) append_edge(name, edge, {}, args.edge);
  if (!args.add_springs) return;
  for (const Vec2i& pair : detail::spring_pairs(edges))
    append_spring(name, pair, args.spring_ke.value_or(default_spring_ke),
                  args.spring_kd.value_or(default_spring_kd), 0.0f, false);
}

void ModelBuilder::add_cloth_mesh(const ClothMeshArgs& args) {
  Transaction transaction(*this);
  append_cloth("add_cloth_mesh", args);
  transaction.keep();
}

void ModelBuilder::append_surface(std::string_view function, std::span<const Vec4i> tetrahedra,
                                  const TriMaterial& tri, bool add_edges,
                                  const EdgeMaterial& edge) {
  const std::vector<Vec3i> surface = detail::surface_of(tetrahedra, function);
  for (const Vec3i& face : surface) append_triangle(function, face, tri);
  if (!add_edges) return;
  for (const Vec4i& e : detail::edges_of(surface, function,
                                         " of the surface: expected at most two, or "
                                         "add_surface_mesh_edges false"))
    append_edge(function, e, {}, edge);
}

void ModelBuilder::add_soft_mesh(const SoftMeshArgs& args) {
  constexpr std::string_view name = "add_soft_mesh";
  Transaction transaction(*this);
  check_mesh(name, args.vertices, args.indices, 4, "tetrahedron");
  const size_t count = args.indices.size() / 4;
  detail::check_tet_materials(name, args.material, count);
  const double density = args.density.value_or(static_cast<double>(default_tet_density));
  require(std::isfinite(density) && density >= 0.0, ErrorKind::Value, name,
          ": density: expected a finite number >= 0, got ", density);
  const int32_t first =
      append_vertices(name, args.placement, args.scale, args.vertices, args.particle_radius);
  std::vector<Vec4i> tetrahedra;
  for (size_t n = 0; n < count; ++n) {
    const auto corner = [&](size_t c) { return first + args.indices[4 * n + c]; };
    const Vec4i t = {corner(0), corner(1), corner(2), corner(3)};
    const float volume = append_tetrahedron(name, t, args.material, n);
    const float mass = static_cast<float>(density) * volume / 4.0f;
    for (const int32_t p : {t.x, t.y, t.z, t.w}) particle_mass[static_cast<size_t>(p)] += mass;
    tetrahedra.push_back(t);
  }
  append_surface(name, tetrahedra, args.tri, args.add_surface_mesh_edges, args.edge);
  transaction.keep();
}

}  // namespace novaphy
