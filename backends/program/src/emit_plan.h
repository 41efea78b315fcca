// Internal to the emitter: what is known about a Program before the first line of text is written.
#pragma once

#include <vector>

#include "novaphy/program/ir.h"

namespace nova::ir {

// Loads of several columns of one row, written as one.
struct LoadGroup {
  int32_t source = 0;
  Value row = kNone;
  std::vector<Value> columns;  // per column of the source the value that it becomes, or kNone
};

// A skippable region of the schedule. One that would skip too little to pay for the question, or is
// in the way of contraction, is written without an `if`; its condition still says which lanes need
// a load.
struct Region {
  int32_t parent = -1;
  Value cond = kNone;
  bool polarity = true;
  bool printed = true;
  int32_t weight = 0;         // of the operations in it
  std::vector<Value> escape;  // values made inside and read outside: declared before the `if`
};

// Values that are written where they are used: constants, parameters, counters, sums.
bool is_leaf(Op op);
// How long an operation takes, in about cycles per vector.
int32_t weight(Op op);

struct EmitPlan {
  std::vector<Step> steps;
  std::vector<Region> regions;
  std::vector<int32_t> region_of_step;  // SkipIfNone: which region it opens
  // per value
  std::vector<char> uniform;  // the same in every lane
  std::vector<char> once;     // computed before the rows
  std::vector<char> used;
  std::vector<char> escapes;    // declared before the region that computes it
  std::vector<int32_t> loop;    // the loop around, or -1
  std::vector<int32_t> region;  // the innermost region around, or -1
  std::vector<int32_t> group;   // loads: the group that this value leads, or -1
  // LT(c, SQRT(x)) with c known before the rows: the SQRT, where the comparison is its only use but
  // for what is needed only if it holds. Then lanes far below the limit need no root.
  std::vector<Value> root;  // of a comparison: that SQRT; of that SQRT: the comparison; or kNone
  std::vector<LoadGroup> groups;

  // Whether a value is computed, for every row, by a line of its own.
  bool is_line(size_t v, Op op) const { return used[v] && !once[v] && !is_leaf(op); }

  int32_t printed_region(int32_t r) const {
    while (r >= 0 && !regions[static_cast<size_t>(r)].printed)
      r = regions[static_cast<size_t>(r)].parent;
    return r;
  }
};

// A region that weighs less costs less than asking whether any lane needs it.
inline constexpr int32_t kMinPrintedRegion = 12;
// `device`: for a thread that has one row.
EmitPlan make_emit_plan(const Program& program, bool device,
                        int32_t min_printed = kMinPrintedRegion);

inline bool is_load(Op op) { return op == Op::LOAD_F || op == Op::LOAD_I; }

}  // namespace nova::ir
