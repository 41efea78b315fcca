#include "novaphy/core/sim/enums.h"

#include "novaphy/core/sim/joint_types.h"

namespace novaphy {

const char* geo_type_name(GeoType type) {
  switch (type) {
#define NOVAPHY_NAME(name, ...) \
  case GeoType::name:           \
    return #name;
    NOVAPHY_SHAPE_TYPES(NOVAPHY_NAME)
#undef NOVAPHY_NAME
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
