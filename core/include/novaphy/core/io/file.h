// The one way in which files are opened for reading.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "novaphy/core/export.h"

namespace novaphy {

// All bytes of a file. ErrorKind::Value, naming `function`, the path and the reason: there is no
// such file, it is a folder or cannot be read.
NOVAPHY_CORE_API std::string read_file(std::string_view function,
                                       const std::filesystem::path& path);

}  // namespace novaphy
