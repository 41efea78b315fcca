// Finds the joints and sites that actuators of MJCF files act on.
#pragma once

#include "mjcf_context.h"

namespace novaphy::detail {

// Finds the transmission of an actuator with `gear`. Returns its name; empty: the transmission is
// not supported.
std::string find_transmission(MjcfContext& context, const Element& e, const double (&gear)[6],
                              MjcfActuator& to);

}  // namespace novaphy::detail
