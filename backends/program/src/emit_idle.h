// Internal to the emitter: idle items, for which a loop adds only constants to its sums. Most items
// are idle.
#pragma once

#include <vector>

#include "emit_kept.h"
#include "emit_plan.h"

namespace nova::ir {

// A shortcut in the body of a loop over the items of a row of a sparse matrix. The body ends in one
// conditional block (`region`), for example the force of a contact that touches. If no SIMD lane
// enters the block, the item adds `terms`, constants that the emitter knows, and the rest of the
// body is skipped.
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
