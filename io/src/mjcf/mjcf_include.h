// Resolves the <include> elements of MJCF files.
#pragma once

#include <filesystem>
#include <span>

#include "../robot/xml.h"

namespace novaphy::detail {

// Replaces <include> elements by the contents of their files. ErrorKind::Value: a file is missing,
// lies in a forbidden folder (see resolve_file), exceeds the common size limit, is not XML, or is
// included twice, as in a cycle.
void include_files(XmlFile& file, std::span<const std::filesystem::path> package_dirs);

}  // namespace novaphy::detail
