// Checks of the friction and penalty laws that a solver's options select (rigid_contact_trace.h).
#pragma once

#include <optional>

#include "novaphy/dynamics/export.h"
#include "novaphy/dynamics/semi_implicit/rigid_contact_trace.h"

namespace novaphy {

// Returns the slip speed (m/s) below which the friction law is smoothed: `smoothing`, or 0.1 if
// empty. ErrorKind::Value, with `solver`: an unknown law; a smoothing that is negative or not
// finite; any smoothing with viscous or newton18, which do not use it; or 0 with newton17.
NOVAPHY_DYNAMICS_API float checked_friction_smoothing(const char* solver, FrictionLaw law,
                                                      std::optional<float> smoothing);
// Checks a penalty law. ErrorKind::Value: an unknown law. ErrorKind::NotImplemented:
// PenaltyLaw::Mean with newton17 or newton18, or for a model with particles, whose contacts support
// only Sampled.
NOVAPHY_DYNAMICS_API void check_penalty_law(const char* solver, PenaltyLaw law,
                                            FrictionLaw friction, bool has_particles);

}  // namespace novaphy
