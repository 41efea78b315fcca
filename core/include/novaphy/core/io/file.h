// What every reader of a file checks first.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "novaphy/core/export.h"

namespace novaphy {

// ErrorKind::Value, naming `function`, the path and the reason: there is no such file, it is a
// folder or cannot be opened.
NOVAPHY_CORE_API void check_readable_file(std::string_view function,
                                          const std::filesystem::path& path);

// All bytes of a file, with the same errors.
NOVAPHY_CORE_API std::string read_file(std::string_view function,
                                       const std::filesystem::path& path);

}  // namespace novaphy
