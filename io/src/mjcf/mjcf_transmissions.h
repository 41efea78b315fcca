// Joints and sites that actuators of MJCF files push.
#pragma once

#include "mjcf_context.h"

namespace novaphy::detail {

// Finds it by `gear`. Returns its name; empty: there is no such transmission here.
std::string find_transmission(MjcfContext& context, const Element& e, const double (&gear)[6],
                              MjcfActuator& to);

}  // namespace novaphy::detail
