// Internal to the emitter: moves arithmetic into the one rarely taken region of a CSR loop that
// uses its result.
#pragma once

#include <vector>

#include "novaphy/program/ir.h"

namespace nova::ir {

// Returns the schedule with arithmetic before a CSR loop moved into the only region that needs it.
// The region then repeats the arithmetic for every active item, but most items are inactive.
std::vector<Step> sunk(const Program& program, std::vector<Step> steps);

}  // namespace nova::ir
