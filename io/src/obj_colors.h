// Colors of the materials of OBJ files.
#pragma once

#include <filesystem>

#include "assimp_scene.h"

namespace novaphy::detail {

// The diffuse colors in the file that the `mtllib` of an OBJ file names, in the folder of that
// file. A file elsewhere, a missing or broken one and materials of images have no colors.
Colors obj_colors(const std::filesystem::path& folder, std::string_view bytes);

}  // namespace novaphy::detail
