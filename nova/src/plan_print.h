// Internal: says how a capture runs on a device whose memory the host may dereference, and why its
// operations do not run block by block.
#pragma once

#include <span>
#include <string>

#include "fusion.h"

namespace nova::detail {

// Whether NOVAPHY_PRINT_PLAN asks for it.
bool prints_plans();

// A part of a plan: a segment of operations.
struct PlanPart {
  Segment segment;
  size_t phases = 0;  // 0: the operations run one by one, or block by block
  size_t scans = 0;   // calls that run several launches of one kernel, row by row
};
// Lines of text, one for each part and one for each kind of operation that is in no block.
std::string describe_plan(std::span<const OpList::Op> ops, std::span<const PlanPart> parts,
                          std::span<const uint64_t> words, std::span<const MemoryAccess> accesses);

}  // namespace nova::detail
