// The softness of MuJoCo's contacts as a spring and a damper.
#pragma once

namespace novaphy::detail {

// As in the attributes solref and solimp of a geom.
struct MjcfSoftness {
  double solref[2] = {0.02, 1.0};
  double solimp[5] = {0.9, 0.95, 0.001, 0.5, 2.0};
};
struct SpringPerMass {
  double ke = 0.0, kd = 0.0;  // 1/s^2, 1/s
};
// MuJoCo's contact at the overlap r with the rate v and the acceleration a pushes with
// -m d / (1 - d) (a + b v + d k r), of the impedance d(r). The spring and the damper are those of
// the overlap with which one contact carries its mass under `gravity`; the part by a is left out.
// `shortest`: of time constants, s.
SpringPerMass spring_per_mass(const MjcfSoftness& of, double gravity, double shortest);

}  // namespace novaphy::detail
