// Internal to the emitter: what all launches of a scan share.
#pragma once

#include <vector>

#include "emit_plan.h"
#include "novaphy/program/scan.h"

namespace nova::ir {

// Per value whether it is the same in every launch, and is computed whatever the conditions: it
// depends on parameters, on tables, and on sources that are neither carried nor varying. A value of
// a CSR loop has one for each item.
std::vector<char> find_held_values(const Program& program, const EmitPlan& plan, const Scan& scan);

}  // namespace nova::ir
