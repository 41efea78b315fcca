// Internal to the emitter: prefetched rows that an index table selects.
#pragma once

#include <vector>

#include "emit_plan.h"

namespace nova::ir {

// A source of three columns that is read at one of these rows. If only a printed region needs the
// source, its gather runs early if the previous group took that region, because neighboring groups
// mostly take the same region. Otherwise `region` is -1.
struct PrefetchedGather {
  int32_t source = 0;
  Value row = kNone;
  int32_t region = -1;
};
// Rows that the columns of a table select, as an element selects its corners. Without a prefetch, a
// group of lanes would wait for the table, the addresses and the rows, one after the other. The
// gathers of the next group therefore run during the computation of the current group.
struct PrefetchedGathers {
  int32_t table = -1;       // the group that loads the table's columns, or -1: no prefetch
  std::vector<Value> rows;  // columns with row indices
  std::vector<PrefetchedGather> gathers;
  // The printed region with most of the arithmetic, or -1. The gathers are placed between its
  // lines.
  int32_t scope = -1;
  int32_t weight = 0;  // weight of the scope
};
PrefetchedGathers find_prefetched_gathers(const Program& program, const EmitPlan& plan);

}  // namespace nova::ir
