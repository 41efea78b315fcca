// Internal to the emitter: idle items, for which a loop adds only constants to its sums. Most items
// are idle.
#pragma once

#include <vector>

#include "emit_kept.h"
#include "emit_plan.h"

namespace nova::ir {

// The terms that a CSR loop adds for an item if no lane of a group takes the single region at its
// end, as for a contact that does not touch. The terms are known when the text is written. The code
// after the region can then be skipped as well.
struct IdleItem {
  int32_t loop = -1, region = -1;
  std::vector<float> terms;  // constant term for each sum of the loop
};

std::vector<IdleItem> find_idle_items(const Program& program, const EmitPlan& plan,
                                      const std::vector<KeptValues>& kept);

// A loop with the same number of iterations as an earlier loop, whose items are idle if the items
// of the earlier loop skip a region. An example is the second sum of an adjoint, for a contact that
// does not touch.
struct FollowedItem {
  IdleItem idle;
  int32_t earlier = -1, earlier_region = -1;
};
std::vector<FollowedItem> find_followed_items(const Program& program, const EmitPlan& plan);

}  // namespace nova::ir
