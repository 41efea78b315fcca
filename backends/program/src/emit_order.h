// Internal to the emitter: the order of lines.
#pragma once

#include "emit_plan.h"

namespace nova::ir {

// Lines without sums in the order in which a processor can begin them, as far as they need not wait
// for one another: it looks ahead only so far, and the lines of a formula come one after the other.
EmitPlan ordered(const Program& program, EmitPlan plan);

}  // namespace nova::ir
