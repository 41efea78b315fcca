// What assimp reads, as a soup of triangles: the only file that knows assimp is beside this one.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "novaphy/math/types.h"

namespace novaphy::detail {

using Triangle = std::array<Vec3f, 3>;

// All triangles of the scene, placed by its nodes; a COLLADA scene in metres with z up. `where`
// begins every message. ErrorKind::Value: assimp refuses the file.
std::vector<Triangle> read_triangles(const std::string& where, const std::filesystem::path& path,
                                     std::string_view extension);

}  // namespace novaphy::detail
