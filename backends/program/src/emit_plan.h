// Internal to the emitter: the analysis of a Program before its source is written.
#pragma once

#include <vector>

#include "novaphy/program/ir.h"

namespace nova::ir {

// Loads of several columns of one row, written as one load.
struct LoadGroup {
  int32_t source = 0;
  Value row = kNone;
  std::vector<Value> columns;  // per column of the source: the value that is loaded from it, or
                               // kNone
};

// A region of the schedule that lanes may skip. A region that is too small for a test, or that
// would prevent contraction, is written without an `if` (not printed). Its condition still
// determines the lanes of a load.
struct Region {
  int32_t parent = -1;
  Value cond = kNone;
  bool polarity = true;
  bool printed = true;
  int32_t weight = 0;         // weight of the operations inside
  std::vector<Value> escape;  // values computed inside and read outside, declared before the `if`
};

// Returns whether the emitter writes the operation wherever its value is used, without a variable,
// as for constants, parameters, loop indices and finished sums.
bool is_leaf(Op op);
// Returns the approximate cost of an operation, in cycles per vector.
int32_t weight(Op op);

struct EmitPlan {
  std::vector<Step> steps;
  std::vector<Region> regions;
  std::vector<int32_t> region_of_step;  // per step: the region that a SkipIfNone step opens
  // The members below have one entry per value.
  std::vector<char> uniform;  // the same in every lane
  std::vector<char> once;     // computed once, before the loop over rows
  std::vector<char> used;
  std::vector<char> escapes;    // whether it is declared before the region that computes it
  std::vector<int32_t> loop;    // the enclosing loop, or -1
  std::vector<int32_t> region;  // the innermost enclosing region, or -1
  std::vector<int32_t> group;   // loads: the group led by this value, or -1
  // Pairs of a comparison LT(c, SQRT(x)) and its SQRT. c is known before the loop over rows, and
  // only the comparison, and values under its condition, use the SQRT. Lanes whose x is far below
  // the limit then skip the square root.
  std::vector<Value> root;  // per comparison: its SQRT; per SQRT: its comparison; or kNone
  std::vector<LoadGroup> groups;

  // Returns whether the loop over rows has a line that computes the value.
  bool is_line(size_t v, Op op) const { return used[v] && !once[v] && !is_leaf(op); }

  int32_t printed_region(int32_t r) const {
    while (r >= 0 && !regions[static_cast<size_t>(r)].printed)
      r = regions[static_cast<size_t>(r)].parent;
    return r;
  }
};

// A region with less weight costs less than the test whether any lane needs it.
inline constexpr int32_t kMinPrintedRegion = 12;
// Makes the plan of a Program. `device`: the text is for a device, where a thread computes one row.
EmitPlan make_emit_plan(const Program& program, bool device,
                        int32_t min_printed = kMinPrintedRegion);

inline bool is_load(Op op) { return op == Op::LOAD_F || op == Op::LOAD_I; }

}  // namespace nova::ir
