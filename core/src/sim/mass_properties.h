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

// Returns the mass properties of a shape in its own frame, for density cfg.density. A shell
// (is_solid false) has walls of cfg.margin inside of its surface. A plane has no mass. For MESH and
// CONVEX_MESH, `solid` has the properties for density 1. ErrorKind::Value: a shell whose wall has
// no thickness or is thicker than the shape.
MassProperties shape_mass(std::string_view function, GeoType type, const Vec3f& scale,
                          const ShapeConfig& cfg, const SolidProperties& solid = {});
// Returns the mass properties in an outer frame. `xform` is the pose of the body's frame in the
// outer frame.
MassProperties moved(const MassProperties& body, const Transformf& xform);
// Returns the sum of two mass properties in the same frame.
MassProperties combined(const MassProperties& a, const MassProperties& b);

// The corrections of an inertia in finalize: ModelBuilder::balance_inertia and bound_inertia.
struct InertiaMending {
  bool balance = false;
  std::optional<float> bound = {};  // kg m^2
};
// Throws ErrorKind::Value unless the matrix is the inertia of an extended body: finite, symmetric,
// positive definite, and no principal moment exceeds the sum of the other two. Faults that `later`
// will correct are accepted. The matrix must be positive definite despite float32 rounding of its
// entries. This allows any ratio of moments along the axes of the body, and moments down to 1e-7 of
// the largest along other axes.
void check_inertia(const Where& where, const Mat33f& inertia, const InertiaMending& later = {});
// Adds a multiple of the identity as `how` says, and returns the multiple (kg m^2). Returns 0 if no
// correction is needed, or if check_inertia refuses the matrix anyway.
double mend_inertia(Mat33f& inertia, const InertiaMending& how);

}  // namespace novaphy::detail
