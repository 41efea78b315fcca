// Internal to the emitter: work that only a rarely taken region of a CSR loop needs.
#pragma once

#include <vector>

#include "novaphy/program/ir.h"

namespace nova::ir {

// The schedule, with arithmetic before a CSR loop moved into the region of the loop that alone
// needs it. There it is done for every item that acts, which most do not.
std::vector<Step> sunk(const Program& program, std::vector<Step> steps);

}  // namespace nova::ir
