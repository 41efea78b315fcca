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

// A loop of as many steps as an earlier one, whose items are idle where those of the earlier one
// take no part in a region: the second sum of an adjoint, where a contact does not touch.
struct FollowedItem {
  IdleItem idle;
  int32_t earlier = -1, earlier_region = -1;
};
std::vector<FollowedItem> find_followed_items(const Program& program, const EmitPlan& plan);

}  // namespace nova::ir
