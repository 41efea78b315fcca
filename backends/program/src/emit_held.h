// Internal to the emitter: held values, which are the same in all launches of a scan.
#pragma once

#include <vector>

#include "emit_plan.h"
#include "novaphy/program/scan.h"

namespace nova::ir {

// Returns, per value, whether it is the same in every launch and is computed regardless of
// conditions. Such a value depends on parameters, tables, and sources that are neither carried nor
// varying. In a CSR loop such a value exists once per item.
std::vector<char> find_held_values(const Program& program, const EmitPlan& plan, const Scan& scan);

}  // namespace nova::ir
