// Internal to the emitter: sums to which most items of a loop add a constant.
#pragma once

#include <vector>

#include "emit_kept.h"
#include "emit_plan.h"

namespace nova::ir {

// What a CSR loop adds for an item where no lane of a group takes the one region at its end: known
// when the text is written, so nothing of what follows the region has to be computed there.
// Contacts that do not touch are such items.
struct IdleItem {
  int32_t loop = -1, region = -1;
  std::vector<float> terms;  // of each sum of the loop
};

std::vector<IdleItem> find_idle_items(const Program& program, const EmitPlan& plan,
                                      const std::vector<KeptValues>& kept);

}  // namespace nova::ir
