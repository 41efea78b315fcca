// A Program in two, for a thread that waits for some of its sources only.
#pragma once

#include <cstdint>
#include <vector>

#include "novaphy/program/ir.h"

namespace nova::ir {

struct Cut {
  // What needs no late source. Its outputs, one of floats and one of ints (a bool is 0 or 1), are
  // the values that `late` takes from it; none: nothing of the Program can be computed early.
  Program early;
  // The rest. Its sources are those of the Program, then the outputs of `early`, read at the row
  // itself.
  Program late;
};
// When a source is there. What both halves have, both read at the row itself.
enum class Available : uint8_t { Early, Late, Both };
// `sources`: of each. One after the other the two give the Program's bits, and read no row that it
// would not read. Loops are all in `late`.
Cut cut(const Program& program, const std::vector<Available>& sources);

}  // namespace nova::ir
