// Sources that a fused list can load before its loop over the items of a CSR sum (the contacts of a
// particle). A source is read at the item, or at a row that such a source names.
#pragma once

#include <cstdint>
#include <vector>

#include "novaphy/program/ir.h"

namespace novaphy::gpu {

struct ItemSource {
  enum How : uint8_t { Not, AtSlot, AtIndex } how = Not;
  int32_t index = 0, column = 0;  // AtIndex: the source, read at the item, that names the row
};
// Per source of a Program. A source that is read in any other way is none.
std::vector<ItemSource> item_sources(const nova::ir::Program& program);

}  // namespace novaphy::gpu
