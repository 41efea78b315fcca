// The friction law of rigid contacts that the options of a solver choose (rigid_contact_trace.h).
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

}  // namespace novaphy
