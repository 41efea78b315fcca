// Geoms of MJCF files.
#pragma once

#include <optional>
#include <string>

#include "mjcf_defaults.h"

namespace novaphy::detail {

// The shape of a <geom>, with its friction, filter bits and colour. `with_mass`: its density
// counts.
RobotShape read_geom(const XmlFile& file, const MjcfDefaults& defaults,
                     const MjcfCompiler& compiler, const Element& e, const std::string& childclass,
                     const ShapeConfig& base, const std::string& label, bool with_mass);

}  // namespace novaphy::detail
