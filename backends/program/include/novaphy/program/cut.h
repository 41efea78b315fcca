// Splits a Program in two, for a thread that waits only for some of its sources.
#pragma once

#include <cstdint>
#include <vector>

#include "novaphy/program/ir.h"

namespace nova::ir {

struct Cut {
  // The part that needs no late source. This part has one output of floats and one of ints (a bool
  // is 0 or 1), with the values for `late`. No output: no part of the Program can be computed
  // early.
  Program early;
  // The rest of the Program. The sources are those of the Program, then the outputs of `early`,
  // which the rest reads at its own row.
  Program late;
};
// When a source is available. Both: both halves may read it, at the own row.
enum class Available : uint8_t { Early, Late, Both };
// `sources`: for each source. The two halves in sequence give the same bits as the Program, and
// read no other rows. All loops are in `late`.
Cut cut(const Program& program, const std::vector<Available>& sources);

}  // namespace nova::ir
