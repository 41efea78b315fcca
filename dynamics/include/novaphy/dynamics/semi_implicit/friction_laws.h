// The laws of rigid contacts that the options of a solver choose (rigid_contact_trace.h).
#pragma once

#include <optional>

#include "novaphy/dynamics/export.h"
#include "novaphy/dynamics/semi_implicit/rigid_contact_trace.h"

namespace novaphy {

// The slip (m/s) up to which the law is smooth: that of the options, 0.1 when empty.
// ErrorKind::Value names `solver`: an unknown law, a smoothing that is negative or not finite, or
// one given with viscous or newton18, which do not read it, or 0 with newton17.
NOVAPHY_DYNAMICS_API float checked_friction_smoothing(const char* solver, FrictionLaw law,
                                                      std::optional<float> smoothing);
// ErrorKind::Value: an unknown law; ErrorKind::NotImplemented: the mean with newton17 or newton18,
// or of a model with particles, whose contacts are sampled.
NOVAPHY_DYNAMICS_API void check_penalty_law(const char* solver, PenaltyLaw law,
                                            FrictionLaw friction, bool has_particles);

}  // namespace novaphy
