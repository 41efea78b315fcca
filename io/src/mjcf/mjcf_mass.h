// Masses of geoms and bodies of MJCF files, in double precision.
#pragma once

#include "mjcf_settings.h"

namespace novaphy::detail {

// In the frame of a geom, of density 1: the inertia is about `com`.
struct SolidMass {
  double volume = 0.0;  // of a shell: its area
  Vec3d com{};
  Mat33d inertia{};
};

enum class MeshInertia { Legacy, Exact, Convex, Shell };

// Of a sphere, capsule, cylinder, ellipsoid or box, with the scale of GeoType.
SolidMass primitive_mass(GeoType type, const Vec3d& scale);
// As MuJoCo has them: of the pyramids between the triangles and the middle of the surface, with
// their signs (Exact) or without (Legacy), or of the triangles themselves (Shell).
SolidMass mesh_mass(const Mesh& surface, MeshInertia how);

// boundmass, boundinertia, balanceinertia and settotalmass, in this order.
void mend_masses(Robot& robot, const MjcfCompiler& compiler);

}  // namespace novaphy::detail
