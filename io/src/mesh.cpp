#include "novaphy/io/mesh.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <string>

#include "assimp_scene.h"
#include "glb.h"
#include "novaphy/core/error.h"
#include "novaphy/core/geometry/join_vertices.h"
#include "novaphy/core/io/file.h"
#include "novaphy/math/functions.h"
#include "obj_colors.h"
#include "whole_file.h"

namespace novaphy {
namespace {

using detail::Triangle;

std::string format_of(std::string_view function, const std::filesystem::path& path) {
  std::string extension = path.extension().string();
  for (char& c : extension)
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  for (const std::string_view known : {".obj", ".stl", ".ply", ".dae", ".glb"})
    if (extension == known) return extension;
  fail(ErrorKind::Value, function, ": ", path.string(),
       ": expected a name that ends in .obj, .stl, .ply, .dae or .glb, got ",
       extension.empty() ? "one without an ending" : extension);
}

void check_finite(const std::string& where, const std::vector<Triangle>& triangles) {
  for (size_t n = 0; n < triangles.size(); ++n)
    for (const Vec3f& v : triangles[n])
      require(std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z), ErrorKind::Value,
              where, ": triangle ", n, ": expected finite float32 positions, got (", v.x, ", ", v.y,
              ", ", v.z, ")");
}

bool has_two_equal_corners(const Triangle& t) {
  return t[0] == t[1] || t[1] == t[2] || t[2] == t[0];
}

void check_degenerate(const std::string& where, detail::Soup& soup, bool drop) {
  std::vector<Triangle>& triangles = soup.triangles;
  if (drop) {
    size_t kept = 0;
    for (size_t n = 0; n < triangles.size(); ++n) {
      if (has_two_equal_corners(triangles[n])) continue;
      triangles[kept] = triangles[n];
      soup.colors[kept++] = soup.colors[n];
    }
    triangles.resize(kept);
    soup.colors.resize(kept);
    require(!triangles.empty(), ErrorKind::Value, where,
            ": expected a triangle with three different corners, got degenerate ones only");
    return;
  }
  const auto first = std::find_if(triangles.begin(), triangles.end(), has_two_equal_corners);
  if (first == triangles.end()) return;
  fail(ErrorKind::Value, where, ": triangle ", first - triangles.begin(),
       ": expected three different corners, got two at one position (",
       std::count_if(first, triangles.end(), has_two_equal_corners), " of ", triangles.size(),
       " triangles have; drop_degenerate leaves them out)");
}

// Sets the color of most of the surface and the colors of the triangles. If all triangles have one
// color, the list stays empty.
void set_colors(detail::Soup& soup, Mesh& mesh) {
  std::map<std::array<float, 3>, double> areas;
  for (size_t n = 0; n < soup.triangles.size(); ++n) {
    const auto& color = soup.colors[n];
    if (!color) continue;
    const Triangle& t = soup.triangles[n];
    const Vec3f across = math::cross(t[1] - t[0], t[2] - t[0]);
    areas[{color->x, color->y, color->z}] += std::sqrt(double{math::dot(across, across)});
  }
  const auto most = std::max_element(areas.begin(), areas.end(),
                                     [](auto& a, auto& b) { return a.second < b.second; });
  if (most != areas.end()) mesh.color = {most->first[0], most->first[1], most->first[2]};
  const bool differ = std::any_of(soup.colors.begin(), soup.colors.end(),
                                  [&](const auto& c) { return c != soup.colors.front(); });
  if (differ) mesh.colors = std::move(soup.colors);
}

}  // namespace

std::vector<Mesh> parts_by_color(const Mesh& mesh) {
  if (mesh.colors.empty()) return {mesh};
  std::vector<Mesh> parts;
  std::vector<std::vector<int32_t>> row_of;  // new index of each vertex in each part
  for (size_t n = 0; n < mesh.colors.size(); ++n) {
    const auto same = [&](const Mesh& part) { return part.color == mesh.colors[n]; };
    const auto found = std::find_if(parts.begin(), parts.end(), same);
    const auto k = static_cast<size_t>(found - parts.begin());
    if (found == parts.end()) {
      parts.push_back({.vertices = {}, .indices = {}, .color = mesh.colors[n]});
      row_of.emplace_back(mesh.vertices.size(), -1);
    }
    Mesh& part = parts[k];
    for (size_t c = 3 * n; c < 3 * n + 3; ++c) {
      int32_t& row = row_of[k][static_cast<size_t>(mesh.indices[c])];
      if (row < 0) {
        row = static_cast<int32_t>(part.vertices.size());
        part.vertices.push_back(mesh.vertices[static_cast<size_t>(mesh.indices[c])]);
      }
      part.indices.push_back(row);
    }
  }
  return parts;
}

Mesh load_mesh(const std::filesystem::path& path, const MeshOptions& options) {
  constexpr std::string_view name = "load_mesh";
  const std::string extension = format_of(name, path);
  const std::string where = std::string(name) + ": " + path.string();
  std::string bytes = read_file(name, path);
  detail::check_whole(where, extension, bytes);
  detail::Colors colors;
  const bool is_obj = extension == ".obj";
  if (is_obj) {
    colors = detail::obj_colors(path.parent_path(), bytes);
    bytes = detail::obj_for_assimp(where, bytes);
  }
  detail::Soup soup = extension == ".glb" ? detail::read_glb(where, bytes)
                                          : detail::read_triangles(where, bytes, extension,
                                                                   is_obj ? &colors : nullptr);
  std::vector<Triangle>& triangles = soup.triangles;
  require(!triangles.empty(), ErrorKind::Value, where,
          ": expected at least one triangle, got an empty mesh");
  require(triangles.size() <= std::numeric_limits<int32_t>::max() / 3, ErrorKind::Value, where,
          ": expected at most ", std::numeric_limits<int32_t>::max() / 3, " triangles, got ",
          triangles.size());
  check_finite(where, triangles);
  check_degenerate(where, soup, options.drop_degenerate);

  Mesh mesh;
  set_colors(soup, mesh);
  std::vector<Vec3f> corners;
  corners.reserve(3 * triangles.size());
  for (const Triangle& triangle : triangles)
    for (const Vec3f& c : triangle)
      corners.push_back({c.x + 0.0f, c.y + 0.0f, c.z + 0.0f});  // adding 0 turns -0 into +0
  if (!options.join_vertices) {
    mesh.indices.resize(corners.size());
    std::iota(mesh.indices.begin(), mesh.indices.end(), 0);
    mesh.vertices = std::move(corners);
    return mesh;
  }
  mesh.indices = first_at_position(corners);
  for (size_t k = 0; k < corners.size(); ++k) {
    int32_t& row = mesh.indices[k];
    if (row == static_cast<int32_t>(k)) {
      row = static_cast<int32_t>(mesh.vertices.size());
      mesh.vertices.push_back(corners[k]);
    } else {
      row = mesh.indices[static_cast<size_t>(row)];
    }
  }
  return mesh;
}

}  // namespace novaphy
