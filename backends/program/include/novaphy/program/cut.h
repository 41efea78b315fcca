// Splits a Program into a part that reads only early sources, and the rest. A thread can run the
// first part before it waits for the other sources.
#pragma once

#include <cstdint>
#include <vector>

#include "novaphy/program/ir.h"

namespace nova::ir {

struct Cut {
  // The part that reads no late source. It has one output of floats and one of ints, with the
  // values that `late` needs (a bool is 0 or 1). Without outputs, no part of the Program can be
  // computed early.
  Program early;
  // The rest of the Program. Its sources are those of the Program, followed by the outputs of
  // `early`, which are read at the own row.
  Program late;
};
// When a source is available. With Both, both parts may read it, at their own row only.
enum class Available : uint8_t { Early, Late, Both };
// `sources` says when each source is available. The two parts in sequence give the same bits as the
// Program, and read no other rows. All loops are in `late`.
Cut cut(const Program& program, const std::vector<Available>& sources);

}  // namespace nova::ir
