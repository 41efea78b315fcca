// Internal to the emitter: values that a sum over CSR rows would compute again, after an earlier
// sum computed them for the items of the same rows. Adjoints have such sums, because their first
// sum is the sum of the primal.
#pragma once

#include "emit_plan.h"

namespace nova::ir {

struct KeptValues {
  int32_t loop = -1, earlier = -1;
  // Unconditional values of `loop`, in their order, with the equal values of `earlier`. They depend
  // only on each other and on values from outside of the loops.
  std::vector<std::pair<Value, Value>> equal;
  // Those values of `equal` that the rest of the loop reads.
  std::vector<std::pair<Value, Value>> kept;
};

// Returns the values that are worth the memory, at most one set per loop. The analysis finds which
// values two loops have in common. At run time, a test finds whether both loops run over the same
// rows.
std::vector<KeptValues> find_kept_values(const Program& program, const EmitPlan& plan);

}  // namespace nova::ir
