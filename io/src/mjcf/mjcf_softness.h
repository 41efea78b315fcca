// Converts the softness of MuJoCo's contacts to a spring and a damper.
#pragma once

namespace novaphy::detail {

// The softness of a geom's contacts: MuJoCo's attributes solref and solimp.
struct MjcfSoftness {
  double solref[2] = {0.02, 1.0};
  double solimp[5] = {0.9, 0.95, 0.001, 0.5, 2.0};
};
struct SpringPerMass {
  double ke = 0.0, kd = 0.0;  // 1/s^2, 1/s
};
// Converts a softness to a spring and a damper per unit of mass. MuJoCo's contact with overlap r,
// rate v and acceleration a has the force -m d / (1 - d) (a + b v + d k r) with the impedance d(r).
// The returned values are those at the overlap at which one contact carries its mass m under
// `gravity` (m/s^2). The term with a is left out. `shortest`: smallest time constant (s).
SpringPerMass spring_per_mass(const MjcfSoftness& of, double gravity, double shortest);

}  // namespace novaphy::detail
