// Internal to the emitter: the order of the generated lines.
#pragma once

#include "emit_plan.h"

namespace nova::ir {

// Reorders lines without sums for the processor, which looks ahead only a limited distance.
// Independent lines are interleaved, because consecutive lines of a formula depend on each other.
EmitPlan ordered(const Program& program, EmitPlan plan);

}  // namespace nova::ir
