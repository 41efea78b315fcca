// Internal to the emitter: fewer operations that give the same bits.
#pragma once

#include "novaphy/program/ir.h"

namespace nova::ir {

// Adjoints of selects come in halves: (c ? 0 : a) + (c ? b : 0) becomes (c ? b : a) + 0. The last 0
// stays, because -0 + 0 is 0. Negations of factors become subtractions where no sums are (what
// their items ask and what their adjoints ask is compared as it is written).
Program simplified(Program program);

// Whether the value can be told to be no negative zero: adding 0 to it changes nothing.
bool is_no_negative_zero(const Program& program, Value value);

}  // namespace nova::ir
