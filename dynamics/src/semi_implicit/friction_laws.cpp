#include "novaphy/dynamics/semi_implicit/friction_laws.h"

#include <cmath>

#include "novaphy/core/error.h"

namespace novaphy {

float checked_friction_smoothing(const char* solver, FrictionLaw law,
                                 std::optional<float> smoothing) {
  constexpr float kDefault = 0.1f;
  const bool reads = law == FrictionLaw::Huber || law == FrictionLaw::Newton17;
  const bool known = reads || law == FrictionLaw::Viscous || law == FrictionLaw::Newton18;
  require(known, ErrorKind::Value, solver, ": friction_law: expected a FrictionLaw, got ",
          static_cast<int>(law));
  if (!smoothing) return kDefault;
  require(reads, ErrorKind::Value, solver,
          ": friction_smoothing: expected none with the friction law \"",
          law == FrictionLaw::Viscous ? "viscous" : "newton18", "\", which does not read it, got ",
          *smoothing);
  require(std::isfinite(*smoothing) && *smoothing >= 0.0f, ErrorKind::Value, solver,
          ": friction_smoothing: expected a finite number >= 0, got ", *smoothing);
  require(law != FrictionLaw::Newton17 || *smoothing > 0.0f, ErrorKind::Value, solver,
          ": friction_smoothing: expected > 0 with \"newton17\", got 0");
  return *smoothing;
}

void check_penalty_law(const char* solver, PenaltyLaw law, FrictionLaw friction,
                       bool has_particles) {
  if (law == PenaltyLaw::Sampled) return;
  require(law == PenaltyLaw::Mean, ErrorKind::Value, solver,
          ": penalty_law: expected a PenaltyLaw, got ", static_cast<int>(law));
  require(!is_of_newton(friction), ErrorKind::NotImplemented, solver,
          ": penalty_law \"mean\" is not supported with the friction law \"",
          friction == FrictionLaw::Newton17 ? "newton17" : "newton18",
          "\"; use \"viscous\" or \"huber\"");
  require(!has_particles, ErrorKind::NotImplemented, solver,
          ": penalty_law \"mean\" is not supported for contacts of particles; use \"sampled\"");
}

}  // namespace novaphy
