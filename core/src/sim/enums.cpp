#include "novaphy/core/sim/enums.h"

#include "novaphy/core/sim/joint_types.h"

namespace novaphy {

const char* geo_type_name(GeoType type) {
  switch (type) {
    case GeoType::NONE:
      return "NONE";
    case GeoType::PLANE:
      return "PLANE";
    case GeoType::HFIELD:
      return "HFIELD";
    case GeoType::SPHERE:
      return "SPHERE";
    case GeoType::CAPSULE:
      return "CAPSULE";
    case GeoType::ELLIPSOID:
      return "ELLIPSOID";
    case GeoType::CYLINDER:
      return "CYLINDER";
    case GeoType::BOX:
      return "BOX";
    case GeoType::MESH:
      return "MESH";
    case GeoType::CONE:
      return "CONE";
    case GeoType::CONVEX_MESH:
      return "CONVEX_MESH";
  }
  return "unknown";
}

const char* joint_type_name(JointType type) {
  switch (type) {
#define NOVAPHY_NAME(name, ...) \
  case JointType::name:         \
    return #name;
    NOVAPHY_JOINT_TYPES(NOVAPHY_NAME)
#undef NOVAPHY_NAME
  }
  return "unknown";
}

}  // namespace novaphy
