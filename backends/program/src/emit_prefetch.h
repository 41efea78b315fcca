// Internal to the emitter: rows through a table that are prefetched.
#pragma once

#include <vector>

#include "emit_plan.h"

namespace nova::ir {

// A source of three columns at one of these rows. What a printed region alone needs is gathered
// early where the group before took that region, as neighbors mostly do the same; else `region` is
// -1.
struct PrefetchedGather {
  int32_t source = 0;
  Value row = kNone;
  int32_t region = -1;
};
// The rows that the columns of one table name, as an element names its corners. A group of lanes
// begins with waiting for them: the table, then their addresses, then the rows. So they are
// gathered while the group before is computed, which keeps all parts of the processor busy.
struct PrefetchedGathers {
  int32_t table = -1;       // the group of loads of its columns, or -1: nothing is prefetched
  std::vector<Value> rows;  // columns that name rows
  std::vector<PrefetchedGather> gathers;
  // Where most of the arithmetic is: a printed region, or -1. The gathers stand between its lines.
  int32_t scope = -1;
  int32_t weight = 0;  // of the scope
};
PrefetchedGathers find_prefetched_gathers(const Program& program, const EmitPlan& plan);

}  // namespace nova::ir
