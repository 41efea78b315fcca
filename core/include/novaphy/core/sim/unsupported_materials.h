// Checks for settings of shapes and springs that a solver does not support. A value other than the
// default is refused; 0, which switches the force off, is accepted. No setting is ignored silently.
#pragma once

#include <array>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/export.h"
#include "novaphy/core/sim/model.h"

namespace novaphy {

class NOVAPHY_CORE_API UnsupportedMaterials {
 public:
  // The settings that a solver supports besides ke, kd and mu. No solver supports mu_torsional and
  // mu_rolling.
  struct Reads {
    bool kf = true, ka = true, restitution = false;
    bool ropes = true;  // particle_spring_tension_only; true also without particles
  };
  UnsupportedMaterials(const char* solver, Reads reads) : solver_(solver), reads_(reads) {}

  // Checks the arrays. A call is cheap if no array was written since the last call.
  // ErrorKind::NotImplemented names the shape or the spring, and the setting. The recorder is not
  // told that the host reads the arrays, because no kernel depends on the result.
  void check(const Model& model);

 private:
  const char* solver_;
  Reads reads_;
  void check_ropes(const Model& model);

  std::array<ArrayStamp, 5> known_;
  ArrayStamp ropes_;
};

}  // namespace novaphy
