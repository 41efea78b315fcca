// Shapes of a ModelBuilder that are meshes and convex hulls.
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <string>

#include "builder_checks.h"
#include "geometry/vector_double.h"
#include "novaphy/core/error.h"
#include "novaphy/core/geometry/hull_of_all.h"
#include "novaphy/core/geometry/join_vertices.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/core/warning.h"

namespace novaphy {
namespace {

void check_vertices(std::string_view name, std::span<const Vec3f> vertices) {
  require(!vertices.empty(), ErrorKind::Value, name, ": vertices: expected some, got none");
  for (size_t i = 0; i < vertices.size(); ++i)
    detail::check_finite({name, "vertices", i}, vertices[i]);
}

// Runs f and prepends `name` and `argument` to the message of an error.
template <class F>
auto named(std::string_view name, std::string_view argument, F f) {
  try {
    return f();
  } catch (const Error& e) {
    fail(e.kind(), name, ": ", argument, ": ", e.what());
  }
}

std::vector<Vec3i> rows_of_three(std::span<const int32_t> indices) {
  std::vector<Vec3i> rows;
  for (size_t i = 0; i + 2 < indices.size(); i += 3)
    rows.push_back({indices[i], indices[i + 1], indices[i + 2]});
  return rows;
}

template <class T>
std::string_view bytes_of(const std::vector<T>& values) {
  return {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)};
}

// Returns the volume (m^3, < 0) of a closed mesh whose triangles face inward, and 0 for any other
// mesh.
double inside_out_volume(const std::vector<Vec3f>& vertices, const std::vector<Vec3i>& triangles) {
  using detail::Vec3d;
  const Vec3d middle = detail::to_double(vertices[0]);
  Vec3d sum{};
  double area = 0.0, volume = 0.0;
  std::vector<std::pair<int32_t, int32_t>> edges;
  for (const Vec3i& t : triangles) {
    const auto at = [&](int32_t i) {
      return detail::to_double(vertices[static_cast<size_t>(i)]) - middle;
    };
    const Vec3d a = at(t.x), b = at(t.y), c = at(t.z), twice = math::cross(b - a, c - a);
    sum = sum + twice;
    area += detail::norm(twice);
    volume += math::dot(a, math::cross(b, c)) / 6.0;
  }
  // The area vectors of a closed mesh sum to 0. The area vectors of an open terrain do not.
  if (!(volume < -1e-12 * area * std::sqrt(area)) || detail::norm(sum) > 1e-6 * area) return 0.0;
  for (const Vec3i& t : triangles) edges.insert(edges.end(), {{t.x, t.y}, {t.y, t.z}, {t.z, t.x}});
  std::sort(edges.begin(), edges.end());
  const bool is_closed = std::all_of(edges.begin(), edges.end(), [&](const auto& edge) {
    return std::binary_search(edges.begin(), edges.end(), std::pair(edge.second, edge.first));
  });
  return is_closed ? volume : 0.0;
}

}  // namespace

std::shared_ptr<const ModelBuilder::Mesh> ModelBuilder::shared_mesh(Mesh mesh) {
  const std::hash<std::string_view> hash;
  const size_t key = hash(bytes_of(mesh.vertices)) ^ (hash(bytes_of(mesh.triangles)) << 1);
  const auto [first, last] = meshes_.equal_range(key);
  for (auto at = first; at != last; ++at)
    if (*at->second == mesh) return at->second;
  return meshes_.emplace(key, std::make_shared<const Mesh>(std::move(mesh)))->second;
}

SolidProperties ModelBuilder::solid_properties(std::string_view name, GeoType type,
                                               const Mesh& mesh, const Vec3f& scale,
                                               const ShapeConfig& cfg) {
  std::vector<Vec3f> vertices;
  for (const Vec3f& v : mesh.vertices)
    vertices.push_back({v.x * scale.x, v.y * scale.y, v.z * scale.z});
  std::vector<int32_t> indices;
  for (const Vec3i& t : mesh.triangles) indices.insert(indices.end(), {t.x, t.y, t.z});
  return named(name, "the mass of cfg.density (0: none)", [&] {
    const bool is_hull = type == GeoType::CONVEX_MESH;
    return cfg.is_solid ? mesh_properties(vertices, indices, is_hull)
                        : shell_properties(vertices, indices, cfg.margin, is_hull);
  });
}

int32_t ModelBuilder::add_shape_mesh(int32_t body, const ShapeMeshArgs& args) {
  constexpr std::string_view name = "add_shape_mesh";
  check_vertices(name, args.vertices);
  const size_t count = args.indices.size();
  require(count != 0 && count % 3 == 0, ErrorKind::Value, name,
          ": indices: expected 3 for each triangle, at least one triangle, got ", count);
  require(count / 3 <= static_cast<size_t>(std::numeric_limits<int32_t>::max()), ErrorKind::Value,
          name, ": indices: too many triangles");
  for (size_t i = 0; i < count; ++i)
    require(args.indices[i] >= 0 && static_cast<size_t>(args.indices[i]) < args.vertices.size(),
            ErrorKind::Index, name, ": indices[", i, "]: expected 0 to ", args.vertices.size() - 1,
            ", got ", args.indices[i]);
  // Keeps the vertices that triangles use, in the order of the input, and one vertex per position.
  const std::vector<int32_t> place = first_at_position(args.vertices);
  std::vector<int32_t> number(place.size(), -1), indices;
  for (const int32_t i : args.indices)
    number[static_cast<size_t>(place[static_cast<size_t>(i)])] = 0;
  Mesh mesh;
  for (size_t i = 0; i < place.size(); ++i) {
    if (number[i] < 0) continue;
    number[i] = static_cast<int32_t>(mesh.vertices.size());
    mesh.vertices.push_back(args.vertices[i]);
  }
  for (const int32_t i : args.indices)
    indices.push_back(number[static_cast<size_t>(place[static_cast<size_t>(i)])]);
  mesh.triangles = rows_of_three(indices);
  for (size_t t = 0; t < mesh.triangles.size(); ++t) {
    const Vec3i& v = mesh.triangles[t];
    require(v.x != v.y && v.y != v.z && v.z != v.x, ErrorKind::Value, name, ": indices: triangle ",
            t, " has two corners in one place");
  }
  const ShapeConfig& cfg = args.cfg ? *args.cfg : default_shape_cfg;
  // A mesh that gives its body a mass needs no warning: mesh_properties refuses it if inside out.
  if ((body < 0 || !(cfg.density > 0.0f)) &&
      (cfg.has_shape_collision || cfg.has_particle_collision)) {
    const double volume = inside_out_volume(mesh.vertices, mesh.triangles);
    if (volume < 0.0)
      warn_of(name,
              ": indices: expected triangles counter-clockwise seen from outside, but the "
              "closed mesh is inside out, its volume is ",
              volume,
              " m^3: it holds what is within, as a room does, and lets in what comes from outside");
  }
  return append_shape(name,
                      {.body = body,
                       .type = GeoType::MESH,
                       .xform = args.xform,
                       .scale = args.scale,
                       .cfg = args.cfg,
                       .label = args.label},
                      shared_mesh(std::move(mesh)));
}

int32_t ModelBuilder::add_shape_convex_hull(int32_t body, const ShapeConvexHullArgs& args) {
  constexpr std::string_view name = "add_shape_convex_hull";
  check_vertices(name, args.vertices);
  ConvexHull hull =
      named(name, "vertices", [&] { return convex_hull(args.vertices, args.max_vertices); });
  const Vec3f scale = detail::checked_scale(name, GeoType::CONVEX_MESH, args.scale);
  if (scale.x != scale.y || scale.y != scale.z) {  // checks the scaled hull that the pipeline uses
    std::vector<Vec3f> scaled;
    for (const Vec3f& v : hull.vertices)
      scaled.push_back({v.x * scale.x, v.y * scale.y, v.z * scale.z});
    named(name, "scale", [&] { return convex_hull(scaled); });
  }
  const bool left_out = static_cast<int32_t>(hull.vertices.size()) == args.max_vertices;
  Mesh mesh;
  mesh.triangles = rows_of_three(hull_of_all(hull.vertices));
  mesh.vertices = std::move(hull.vertices);
  // If vertices were left out, the mass is still that of the hull of all points.
  std::optional<SolidProperties> solid;
  const ShapeConfig cfg = args.cfg.value_or(default_shape_cfg);
  if (left_out && body >= 0 && cfg.density > 0.0f)
    solid = solid_properties(
        name, GeoType::CONVEX_MESH,
        {{args.vertices.begin(), args.vertices.end()}, rows_of_three(hull_of_all(args.vertices))},
        scale, cfg);
  const int32_t shape = append_shape(name,
                                     {.body = body,
                                      .type = GeoType::CONVEX_MESH,
                                      .xform = args.xform,
                                      .scale = args.scale,
                                      .cfg = args.cfg,
                                      .label = args.label},
                                     shared_mesh(std::move(mesh)));
  if (solid) shapes_.back().solid = *solid;
  return shape;
}

ModelBuilder::MeshPool ModelBuilder::mesh_pool() const {
  MeshPool pool;
  std::map<const Mesh*, Vec2i> first;  // first vertex and first triangle of each mesh
  constexpr auto kMost = static_cast<size_t>(std::numeric_limits<int32_t>::max());
  for (const Shape& shape : shapes_) {
    if (!shape.mesh) {
      pool.ranges.insert(pool.ranges.end(), 4, 0);
      continue;
    }
    const Mesh& mesh = *shape.mesh;
    const auto [at, is_new] =
        first.try_emplace(&mesh, Vec2i{static_cast<int32_t>(pool.vertices.size()),
                                       static_cast<int32_t>(pool.triangles.size())});
    if (is_new) {
      pool.vertices.insert(pool.vertices.end(), mesh.vertices.begin(), mesh.vertices.end());
      pool.triangles.insert(pool.triangles.end(), mesh.triangles.begin(), mesh.triangles.end());
    }
    require(pool.vertices.size() <= kMost && pool.triangles.size() <= kMost, ErrorKind::Value,
            "finalize: expected at most ", kMost, " vertices and triangles of meshes, got ",
            pool.vertices.size(), " and ", pool.triangles.size());
    pool.ranges.insert(pool.ranges.end(),
                       {at->second.x, static_cast<int32_t>(mesh.vertices.size()), at->second.y,
                        static_cast<int32_t>(mesh.triangles.size())});
  }
  return pool;
}

}  // namespace novaphy
