// Settings of ShapeConfig and of springs that a solver does not read. A value other than the
// default is refused, except for a 0 that means that there is no such force. No setting is ignored
// silently.
#pragma once

#include <array>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/export.h"
#include "novaphy/core/sim/model.h"

namespace novaphy {

class NOVAPHY_CORE_API UnsupportedMaterials {
 public:
  // What a solver reads besides ke, kd and mu. No solver reads mu_torsional and mu_rolling.
  struct Reads {
    bool kf = true, ka = true, restitution = false;
    bool ropes = true;  // particle_spring_tension_only, or the solver has no particles
  };
  UnsupportedMaterials(const char* solver, Reads reads) : solver_(solver), reads_(reads) {}

  // Cheap while the arrays were not written since the last call. ErrorKind::NotImplemented names
  // the shape or the spring, and the setting. Host reads of the arrays are not observed: no kernel
  // depends on them.
  void check(const Model& model);

 private:
  const char* solver_;
  Reads reads_;
  void check_ropes(const Model& model);

  std::array<ArrayStamp, 5> known_;
  ArrayStamp ropes_;
};

}  // namespace novaphy
