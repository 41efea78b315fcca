// Converts the softness of MuJoCo's contacts to a spring and a damper.
#pragma once

namespace novaphy::detail {

// The attributes solref and solimp of a geom.
struct MjcfSoftness {
  double solref[2] = {0.02, 1.0};
  double solimp[5] = {0.9, 0.95, 0.001, 0.5, 2.0};
};
struct SpringPerMass {
  double ke = 0.0, kd = 0.0;  // 1/s^2, 1/s
};
// MuJoCo's contact with overlap r, rate v and acceleration a has the force -m d / (1 - d) (a + b v
// + d k r) with the impedance d(r). The returned spring and damper hold at the overlap at which one
// contact carries its mass under `gravity`. The term with a is left out. `shortest`: smallest time
// constant (s).
SpringPerMass spring_per_mass(const MjcfSoftness& of, double gravity, double shortest);

}  // namespace novaphy::detail
