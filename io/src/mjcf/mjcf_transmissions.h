// Finds the joints and sites on which actuators of MJCF files act.
#pragma once

#include "mjcf_context.h"

namespace novaphy::detail {

// Finds the transmission of an actuator with `gear`. Returns its name, or an empty text if the
// transmission is not supported.
std::string find_transmission(MjcfContext& context, const Element& e, const double (&gear)[6],
                              MjcfActuator& to);

}  // namespace novaphy::detail
