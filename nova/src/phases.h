// Internal: recorded operations cut into phases, for a device that runs many of them as one launch
// with a barrier after each phase.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "novaphy/nova/op_list.h"

namespace nova::detail {

// Where an operation runs. The operations of a phase do not depend on one another, except within a
// chain: there each touches what the others write at its own row only, and row i of the chain is
// done by one thread, operation by operation. An operation over m * rows rows has m there for each.
struct Phased {
  uint32_t op = 0;
  uint32_t phase = 0, chain = 0;  // the chain within the phase
  int64_t rows = 0;               // of the chain
};

// As few phases as the data flow allows. The result is in order of phases, chains and operations.
// What every operation touches must be known.
std::vector<Phased> plan_phases(std::span<const OpList::Op> ops, std::span<const uint64_t> words,
                                std::span<const MemoryAccess> accesses);

}  // namespace nova::detail
