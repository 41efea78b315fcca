// Input arrays (sources) that a fused list can load before its loop over the items of a CSR sum. An
// example of items are the contacts of a particle. A Program must read the source at the item, or
// at a row whose index another source has at the item.
#pragma once

#include <cstdint>
#include <vector>

#include "novaphy/program/ir.h"

namespace novaphy::gpu {

struct ItemSource {
  enum How : uint8_t { Not, AtSlot, AtIndex } how = Not;
  int32_t index = 0, column = 0;  // AtIndex: the source with the row index, read at the item
};
// Classifies the sources of a Program. A source with reads of any other kind is `Not`.
std::vector<ItemSource> item_sources(const nova::ir::Program& program);

}  // namespace novaphy::gpu
