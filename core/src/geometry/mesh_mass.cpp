#include "novaphy/core/geometry/mesh_mass.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "geometry/vector_double.h"
#include "novaphy/core/error.h"
#include "novaphy/math/ldlt.h"

namespace novaphy {
namespace {

using detail::Vec3d;

void check_numbers(std::span<const Vec3f> vertices, std::span<const int32_t> indices) {
  require(!indices.empty() && indices.size() % 3 == 0, ErrorKind::Value,
          "mesh_properties: indices: expected 3 per triangle, got ", indices.size());
  for (size_t i = 0; i < vertices.size(); ++i)
    require(std::isfinite(vertices[i].x) && std::isfinite(vertices[i].y) &&
                std::isfinite(vertices[i].z),
            ErrorKind::Value, "mesh_properties: vertices[", i, "]: expected finite numbers, got (",
            vertices[i].x, ", ", vertices[i].y, ", ", vertices[i].z, ")");
  for (size_t i = 0; i < indices.size(); ++i)
    require(indices[i] >= 0 && static_cast<size_t>(indices[i]) < vertices.size(), ErrorKind::Value,
            "mesh_properties: indices[", i, "]: expected 0 to ", vertices.size(),
            " (exclusive), got ", indices[i]);
}

// Checks that each edge occurs once in each direction. The directed edges are sorted by their
// smaller and larger vertex. The directions of equal edges must sum to 0, and no direction may
// occur twice.
void check_closed(std::span<const int32_t> indices) {
  using Edge = std::pair<int32_t, int32_t>;
  std::vector<Edge> edges;
  edges.reserve(indices.size());
  for (size_t t = 0; t + 2 < indices.size(); t += 3)
    for (size_t k = 0; k < 3; ++k) edges.push_back({indices[t + k], indices[t + (k + 1) % 3]});
  std::sort(edges.begin(), edges.end());
  const auto twice = std::adjacent_find(edges.begin(), edges.end());
  require(twice == edges.end(), ErrorKind::Value,
          "mesh_properties: indices: expected triangles that all face outwards, but two have the "
          "edge from vertex ",
          twice == edges.end() ? 0 : twice->first, " to ",
          twice == edges.end() ? 0 : twice->second);
  for (const auto& [i, j] : edges)
    require(i != j && std::binary_search(edges.begin(), edges.end(), Edge{j, i}), ErrorKind::Value,
            "mesh_properties: indices: expected a closed mesh, but the edge from vertex ", i,
            " to ", j, " has a triangle on one side only");
}

struct Moments {
  double volume = 0.0;
  Vec3d first{};
  double second[3][3] = {};

  void add(const Vec3d& a, const Vec3d& b, const Vec3d& c) {
    const double v = math::dot(a, math::cross(b, c)) / 6.0;
    const Vec3d sum = (a + b) + c;
    volume += v;
    first = first + sum * (v / 4.0);
    const double p[4][3] = {
        {a.x, a.y, a.z}, {b.x, b.y, b.z}, {c.x, c.y, c.z}, {sum.x, sum.y, sum.z}};
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j)
        for (const auto& q : p) second[i][j] += v / 20.0 * q[i] * q[j];
  }
};

// Integrates volume, center and inertia. If the volume is not > 0, only the volume is set.
SolidProperties integrate(const std::vector<Vec3d>& vertices, std::span<const int32_t> indices,
                          const Vec3d& middle) {
  auto corner = [&](size_t i) { return vertices[static_cast<size_t>(indices[i])] - middle; };
  Moments m;
  for (size_t t = 0; t + 2 < indices.size(); t += 3) m.add(corner(t), corner(t + 1), corner(t + 2));
  SolidProperties out;
  out.volume = m.volume;
  if (!(m.volume > 0.0)) return out;
  const Vec3d com = m.first * (1.0 / m.volume);
  out.com = com + middle;
  const double c[3] = {com.x, com.y, com.z};
  double about[3][3];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) about[i][j] = m.second[i][j] - m.volume * c[i] * c[j];
  const double trace = about[0][0] + about[1][1] + about[2][2];
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) out.inertia.m[i][j] = (i == j ? trace : 0.0) - about[i][j];
  return out;
}

std::vector<Vec3d> widened(std::span<const Vec3f> vertices) {
  std::vector<Vec3d> out;
  for (const Vec3f& v : vertices) out.push_back(detail::to_double(v));
  return out;
}

// Adds the inertia of a mass of density 1 at the distance d from the axes (parallel axis theorem).
void add_parallel_axis(Mat33<double>& inertia, double volume, const Vec3d& d) {
  const double c[3] = {d.x, d.y, d.z}, square = math::dot(d, d);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) inertia.m[i][j] += volume * ((i == j ? square : 0.0) - c[i] * c[j]);
}

// Returns the vertices moved inwards to a depth t below the planes of their triangles.
std::vector<Vec3d> moved_inwards(const std::vector<Vec3d>& vertices,
                                 std::span<const int32_t> indices, double t) {
  // The normal equations of each vertex for its displacement d. The displacement minimizes the sum
  // of w (n . d + t)^2 over the triangles at the vertex: n is the unit normal, w the angle, t the
  // depth.
  struct Equations {
    double a[3][3] = {}, b[3] = {};
  };
  std::vector<Equations> equations(vertices.size());
  for (size_t k = 0; k + 2 < indices.size(); k += 3) {
    auto corner = [&](size_t i) { return vertices[static_cast<size_t>(indices[k + i % 3])]; };
    const Vec3d n = detail::unit(math::cross(corner(1) - corner(0), corner(2) - corner(0)));
    const double normal[3] = {n.x, n.y, n.z};
    for (size_t i = 0; i < 3; ++i) {
      const Vec3d u = detail::unit(corner(i + 1) - corner(i)),
                  v = detail::unit(corner(i + 2) - corner(i));
      const double w = std::atan2(detail::norm(math::cross(u, v)), math::dot(u, v));
      Equations& e = equations[static_cast<size_t>(indices[k + i])];
      for (int r = 0; r < 3; ++r) {
        e.b[r] -= w * t * normal[r];
        for (int c = 0; c < 3; ++c) e.a[r][c] += w * normal[r] * normal[c];
      }
    }
  }
  std::vector<Vec3d> inner = vertices;
  constexpr double kShortest = 1e-10;  // regularization as a fraction of the trace; selects the
                                       // shortest of several solutions
  for (size_t i = 0; i < inner.size(); ++i) {
    Equations& e = equations[i];
    const double trace = e.a[0][0] + e.a[1][1] + e.a[2][2];
    if (!(trace > 0.0)) continue;  // no triangle has this vertex
    for (int r = 0; r < 3; ++r) e.a[r][r] += kShortest * trace;
    double d[3];
    math::solve(math::ldlt(e.a), e.b, d);
    inner[i] = inner[i] + Vec3d{d[0], d[1], d[2]};
  }
  return inner;
}

}  // namespace

SolidProperties mesh_properties(std::span<const Vec3f> vertices, std::span<const int32_t> indices,
                                bool is_hull) {
  check_numbers(vertices, indices);
  if (!is_hull) check_closed(indices);
  Vec3d lo = detail::to_double(vertices[static_cast<size_t>(indices[0])]), hi = lo;
  for (const int32_t i : indices) {
    const Vec3d x = detail::to_double(vertices[static_cast<size_t>(i)]);
    lo = {std::min(lo.x, x.x), std::min(lo.y, x.y), std::min(lo.z, x.z)};
    hi = {std::max(hi.x, x.x), std::max(hi.y, x.y), std::max(hi.z, x.z)};
  }
  const SolidProperties solid = integrate(widened(vertices), indices, (lo + hi) * 0.5);
  const double extent = std::max({hi.x - lo.x, hi.y - lo.y, hi.z - lo.z});
  const double least = 1e-12 * extent * extent * extent;
  require(solid.volume >= -least, ErrorKind::Value,
          "mesh_properties: indices: expected triangles counter-clockwise seen from outside, but "
          "the mesh is inside out: its volume is ",
          solid.volume, " m^3");
  require(solid.volume > least, ErrorKind::Value,
          "mesh_properties: expected a mesh that encloses a volume, got ", solid.volume, " m^3");
  return solid;
}

SolidProperties shell_properties(std::span<const Vec3f> vertices, std::span<const int32_t> indices,
                                 float thickness, bool is_hull) {
  require(std::isfinite(thickness) && thickness > 0.0f, ErrorKind::Value,
          "shell_properties: thickness: expected a wall (ShapeConfig.margin) > 0 m, got ",
          thickness);
  const SolidProperties outer = mesh_properties(vertices, indices, is_hull);
  const std::vector<Vec3d> outside = widened(vertices),
                           inside = moved_inwards(outside, indices, thickness);
  auto area = [&](const std::vector<Vec3d>& v, size_t t) {
    const Vec3d a = v[static_cast<size_t>(indices[t])];
    return math::cross(v[static_cast<size_t>(indices[t + 1])] - a,
                       v[static_cast<size_t>(indices[t + 2])] - a);
  };
  for (size_t t = 0; t + 2 < indices.size(); t += 3)
    require(math::dot(area(outside, t), area(inside, t)) >= 0.0, ErrorKind::Value,
            "shell_properties: thickness: expected a wall thinner than the shape, got ", thickness,
            " m, which turns triangle ", t / 3, " over");
  const SolidProperties hollow = integrate(inside, indices, outer.com);
  SolidProperties wall;
  wall.volume = outer.volume - hollow.volume;
  constexpr double kLeast = 1e-6;
  require(hollow.volume > kLeast * outer.volume && wall.volume > 0.0, ErrorKind::Value,
          "shell_properties: thickness: expected a wall thinner than the shape, got ", thickness,
          " m, with a hollow of ", hollow.volume, " m^3 in ", outer.volume);
  wall.com = (outer.com * outer.volume - hollow.com * hollow.volume) * (1.0 / wall.volume);
  wall.inertia = outer.inertia;
  add_parallel_axis(wall.inertia, outer.volume, outer.com - wall.com);
  add_parallel_axis(wall.inertia, -hollow.volume, hollow.com - wall.com);
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) wall.inertia.m[i][j] -= hollow.inertia.m[i][j];
  return wall;
}

}  // namespace novaphy
