// Internal: divides recorded operations into phases, for a device that runs many of them as one
// launch with a barrier after each phase.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "novaphy/nova/op_list.h"

namespace nova::detail {

// The position of an operation in the plan. Operations of a phase are independent, except within a
// chain. In a chain, each operation accesses the data of the others at its own row only, and one
// thread runs all operations of row i in order. An operation over m * rows rows has m rows for each
// row of the chain.
struct Phased {
  uint32_t op = 0;
  uint32_t phase = 0, chain = 0;  // the chain within the phase
  int64_t rows = 0;               // of the chain
};

// Divides the operations into as few phases as the data flow allows. The result is sorted by phase,
// chain and operation. The accesses of every operation must be known.
std::vector<Phased> plan_phases(std::span<const OpList::Op> ops, std::span<const uint64_t> words,
                                std::span<const MemoryAccess> accesses);

}  // namespace nova::detail
