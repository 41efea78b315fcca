// Reads a file with assimp into triangles that share no vertices. Only assimp_scene.cpp includes
// assimp.
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
using Colors = std::map<std::string, Vec3f, std::less<>>;  // material colors by name

struct Soup {
  std::vector<Triangle> triangles;
  std::vector<std::optional<Vec3f>> colors;  // material color of each triangle

  void add(const Triangle& triangle, const std::optional<Vec3f>& color);
};

// Returns all triangles of the scene in a file's `bytes`, placed by its nodes. A COLLADA scene is
// in meters with z up. Every error message begins with `where`. `colors`, if given, replace the
// material colors of the file. ErrorKind::Value: assimp refuses the file, or a face has a corner
// that does not exist.
Soup read_triangles(const std::string& where, std::string_view bytes, std::string_view extension,
                    const Colors* colors);

}  // namespace novaphy::detail
