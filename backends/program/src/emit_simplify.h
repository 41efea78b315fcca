// Internal to the emitter: removes operations without changing the bits of the result.
#pragma once

#include "novaphy/program/ir.h"

namespace nova::ir {

// Adjoints of selects consist of halves: (c ? 0 : a) + (c ? b : 0) becomes (c ? b : a) + 0. The
// last 0 stays, because -0 + 0 is 0. In Programs without sums, negations of factors become
// subtractions. Programs with sums stay as written, because the conditions of primals and adjoints
// are compared by their form.
Program simplified(Program program);

// Returns whether the value is known not to be -0, so that adding 0 has no effect.
bool is_no_negative_zero(const Program& program, Value value);

}  // namespace nova::ir
