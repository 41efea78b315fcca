// Internal to the emitter: values that a sum over CSR rows would compute again, after an earlier
// sum computed them for each item of the same rows. Adjoints have such sums: their first sum is the
// primal's.
#pragma once

#include "emit_plan.h"

namespace nova::ir {

struct KeptValues {
  int32_t loop = -1, earlier = -1;
  // Unconditional values of `loop`, in their order, with their equals in `earlier`. The values
  // depend only on values from outside and on each other.
  std::vector<std::pair<Value, Value>> equal;
  // The values of `equal` that the rest of the loop reads.
  std::vector<std::pair<Value, Value>> kept;
};

// Returns the values that are worth the memory, at most one set per loop. The Program tells which
// values two loops have in common. A run-time test tells whether both loops run over the same rows.
std::vector<KeptValues> find_kept_values(const Program& program, const EmitPlan& plan);

}  // namespace nova::ir
