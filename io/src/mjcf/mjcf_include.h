// The <include> elements of MJCF files.
#pragma once

#include <filesystem>
#include <span>

#include "../robot/xml.h"

namespace novaphy::detail {

// Puts the files that <include> elements name in the places of these. ErrorKind::Value: a file that
// is not there, lies elsewhere (see resolve_file), is too large with the others, is no XML, or is
// included twice, which a cycle does.
void include_files(XmlFile& file, std::span<const std::filesystem::path> package_dirs);

}  // namespace novaphy::detail
