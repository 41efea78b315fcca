// Reads the colors of the materials of OBJ files.
#pragma once

#include <filesystem>

#include "assimp_scene.h"

namespace novaphy::detail {

// Returns the diffuse colors in the material file that `mtllib` of an OBJ file names. The file must
// lie in the same folder. A missing or corrupt file, and materials with images, give no colors.
Colors obj_colors(const std::filesystem::path& folder, std::string_view bytes);

}  // namespace novaphy::detail
