// Internal to the emitter: prefetched rows that a table selects.
#pragma once

#include <vector>

#include "emit_plan.h"

namespace nova::ir {

// A source of three columns at one of these rows. If only a printed region needs the source, it is
// gathered early if the previous group took that region, because neighbors mostly take the same
// one. In other cases `region` is -1.
struct PrefetchedGather {
  int32_t source = 0;
  Value row = kNone;
  int32_t region = -1;
};
// Rows selected by the columns of a table, as an element selects its corners. A group of lanes
// would begin by waiting for the table, the addresses and the rows in turn. The gathers of the next
// group therefore run during the computation of the current one.
struct PrefetchedGathers {
  int32_t table = -1;       // the group of loads of its columns, or -1: no prefetch
  std::vector<Value> rows;  // columns with row indices
  std::vector<PrefetchedGather> gathers;
  // The printed region with most of the arithmetic, or -1. The gathers are placed between its
  // lines.
  int32_t scope = -1;
  int32_t weight = 0;  // of the scope
};
PrefetchedGathers find_prefetched_gathers(const Program& program, const EmitPlan& plan);

}  // namespace nova::ir
