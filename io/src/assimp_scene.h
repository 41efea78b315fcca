// A file that assimp reads, as a soup of triangles. Only assimp_scene.cpp knows assimp.
#pragma once

#include <array>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "novaphy/math/types.h"

namespace novaphy::detail {

using Triangle = std::array<Vec3f, 3>;
using Colors = std::map<std::string, Vec3f, std::less<>>;  // of materials by name

struct Soup {
  std::vector<Triangle> triangles;
  std::vector<std::optional<Vec3f>> colors;  // of their materials

  void add(const Triangle& triangle, const std::optional<Vec3f>& color);
};

// All triangles of the scene in the `bytes` of a file, placed by its nodes; a COLLADA scene in
// meters with z up. `where` begins every message; `colors` instead of those in the file.
// ErrorKind::Value: assimp refuses the file, or a face has a corner that is not there.
Soup read_triangles(const std::string& where, std::string_view bytes, std::string_view extension,
                    const Colors* colors);

}  // namespace novaphy::detail
