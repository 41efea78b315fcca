// Internal to the emitter: what a sum over CSR rows computes again that an earlier sum over the
// same rows has computed for each item. An adjoint does: its first sum is the primal's.
#pragma once

#include "emit_plan.h"

namespace nova::ir {

struct KeptValues {
  int32_t loop = -1, earlier = -1;
  // In `loop`, in their order, with their equals in `earlier`: unconditional, and made of values
  // from outside and of each other only.
  std::vector<std::pair<Value, Value>> equal;
  // Of these, the ones that the rest of the loop reads.
  std::vector<std::pair<Value, Value>> kept;
};

// Those that are worth the memory; at most one per loop. What the loops have in common is decided
// by their text: whether they run over the same rows is asked at run time.
std::vector<KeptValues> find_kept_values(const Program& program, const EmitPlan& plan);

}  // namespace nova::ir
