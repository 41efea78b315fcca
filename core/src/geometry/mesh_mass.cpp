#include "novaphy/core/geometry/mesh_mass.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "geometry/vector_double.h"
#include "novaphy/core/error.h"

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

// Each edge comes as often in one direction as in the other: with edges in the order of their
// smaller and larger vertex, the sum of the directions is 0 (and none comes twice the same way).
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

}  // namespace

SolidProperties mesh_properties(std::span<const Vec3f> vertices, std::span<const int32_t> indices) {
  check_numbers(vertices, indices);
  check_closed(indices);
  Vec3d lo = detail::to_double(vertices[static_cast<size_t>(indices[0])]), hi = lo;
  for (const int32_t i : indices) {
    const Vec3d x = detail::to_double(vertices[static_cast<size_t>(i)]);
    lo = {std::min(lo.x, x.x), std::min(lo.y, x.y), std::min(lo.z, x.z)};
    hi = {std::max(hi.x, x.x), std::max(hi.y, x.y), std::max(hi.z, x.z)};
  }
  const Vec3d middle = (lo + hi) * 0.5;
  auto corner = [&](size_t i) {
    return detail::to_double(vertices[static_cast<size_t>(indices[i])]) - middle;
  };
  Moments m;
  for (size_t t = 0; t + 2 < indices.size(); t += 3) m.add(corner(t), corner(t + 1), corner(t + 2));
  const double extent = std::max({hi.x - lo.x, hi.y - lo.y, hi.z - lo.z});
  const double least = 1e-12 * extent * extent * extent;
  require(m.volume >= -least, ErrorKind::Value,
          "mesh_properties: indices: expected triangles counter-clockwise seen from outside, but "
          "the mesh is inside out: its volume is ",
          m.volume, " m^3");
  require(m.volume > least, ErrorKind::Value,
          "mesh_properties: expected a mesh that encloses a volume, got ", m.volume, " m^3");

  SolidProperties out;
  out.volume = m.volume;
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

}  // namespace novaphy
