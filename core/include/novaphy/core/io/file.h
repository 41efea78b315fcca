// The only function that opens files for reading.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "novaphy/core/export.h"

namespace novaphy {

// Returns all bytes of a file. Throws ErrorKind::Value with `function`, the path and the reason if
// the path does not exist, is a folder or cannot be read.
NOVAPHY_CORE_API std::string read_file(std::string_view function,
                                       const std::filesystem::path& path);

}  // namespace novaphy
