// What assimp reads, as a soup of triangles: the only file that knows assimp is beside this one.
#pragma once

#include <array>
#include <string>
#include <string_view>
#include <vector>

#include "novaphy/math/types.h"

namespace novaphy::detail {

using Triangle = std::array<Vec3f, 3>;

// All triangles of the scene in the `bytes` of a file, placed by its nodes; a COLLADA scene in
// metres with z up. `where` begins every message. ErrorKind::Value: assimp refuses the file, or a
// face has a corner that is not there.
std::vector<Triangle> read_triangles(const std::string& where, std::string_view bytes,
                                     std::string_view extension);

}  // namespace novaphy::detail
