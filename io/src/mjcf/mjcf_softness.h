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
// MuJoCo's contact pushes as mass d / (1 - d) with the acceleration -b v - k r, of the impedance d
// at the overlap r. The spring has this stiffness at the overlap with which one contact carries its
// mass under `gravity`; what nothing pushes then goes apart as slowly as in MuJoCo. `shortest`: of
// time constants, s.
SpringPerMass spring_per_mass(const MjcfSoftness& of, double gravity, double shortest);

}  // namespace novaphy::detail
