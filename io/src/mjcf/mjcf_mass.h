// Masses of geoms and bodies of MJCF files, in double precision.
#pragma once

#include "mjcf_settings.h"

namespace novaphy::detail {

// Mass properties for density 1 in the frame of a geom. The inertia is about `com`.
struct SolidMass {
  double volume = 0.0;  // m^3; for a shell, the area (m^2)
  Vec3d com{};
  Mat33d inertia{};
};

enum class MeshInertia { Legacy, Exact, Convex, Shell };

// Returns the mass properties of a sphere, capsule, cylinder, ellipsoid or box with the scale of
// GeoType.
SolidMass primitive_mass(GeoType type, const Vec3d& scale);
// Returns the mass properties of a mesh as MuJoCo computes them. Exact and Legacy sum the pyramids
// between the triangles and the center of the surface, with signed and absolute volumes. Shell sums
// the triangles themselves.
SolidMass mesh_mass(const Mesh& surface, MeshInertia how);

// Applies boundmass, boundinertia, balanceinertia and settotalmass, in this order.
void mend_masses(Robot& robot, const MjcfCompiler& compiler);

}  // namespace novaphy::detail
