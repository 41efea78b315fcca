// Internal: prints how a recorded list runs on a device whose memory the host can access, and why
// operations do not run block by block.
#pragma once

#include <span>
#include <string>

#include "fusion.h"

namespace nova::detail {

// Returns whether NOVAPHY_PRINT_PLAN is set.
bool prints_plans();

// A part of a plan: a segment of operations.
struct PlanPart {
  Segment segment;
  size_t phases = 0;  // 0: operations run one by one, or block by block
  size_t scans = 0;   // calls that run several launches of one kernel, row by row
};
// Returns the text: a line for each part, and a line for each kind of operation outside of blocks.
std::string describe_plan(std::span<const OpList::Op> ops, std::span<const PlanPart> parts,
                          std::span<const uint64_t> words, std::span<const MemoryAccess> accesses);

}  // namespace nova::detail
