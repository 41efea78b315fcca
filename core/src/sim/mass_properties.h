// Mass, center of mass and inertia of shapes and bodies, in double precision.
#pragma once

#include <optional>
#include <string_view>

#include "builder_checks.h"
#include "novaphy/core/geometry/mesh_mass.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/core/sim/shape_config.h"
#include "novaphy/math/types.h"

namespace novaphy::detail {

struct MassProperties {
  double mass = 0.0;      // kg
  Vec3<double> com{};     // m
  Mat33<double> inertia;  // kg m^2, about com
};

// Of a shape in its own frame, of cfg.density; a shell (is_solid false) has walls of cfg.margin
// inside of its surface. Nothing for a plane. ErrorKind::Value: a shell without a wall, or one
// thicker than the shape.
// MESH and CONVEX_MESH: those of `solid`, its density taken for its volume.
MassProperties shape_mass(std::string_view function, GeoType type, const Vec3f& scale,
                          const ShapeConfig& cfg, const SolidProperties& solid = {});
// The same body, in the frame in which its own has the pose `xform`.
MassProperties moved(const MassProperties& body, const Transformf& xform);
// Both together, in one frame.
MassProperties combined(const MassProperties& a, const MassProperties& b);

// What finalize mends of an inertia: ModelBuilder::balance_inertia, bound_inertia.
struct InertiaMending {
  bool balance = false;
  std::optional<float> bound = {};  // kg m^2
};
// ErrorKind::Value unless the matrix is finite, symmetric and positive definite, and no principal
// moment exceeds the sum of the other two: what the inertia of a body with an extent is. What is
// mended later is not refused. Positive definite must be whatever float32 has made of the entries:
// moments of any ratio along the axes of the body, down to 1e-7 of the largest along others.
void check_inertia(const Where& where, const Mat33f& inertia, const InertiaMending& later = {});
// Adds the multiple of the identity that is asked for, and returns it (kg m^2): 0 where nothing is
// to be mended, or check_inertia refuses the matrix anyway.
double mend_inertia(Mat33f& inertia, const InertiaMending& how);

}  // namespace novaphy::detail
