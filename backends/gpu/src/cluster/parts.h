// Cuts rows into parts that need little more than their share, if rows need what neighbors need,
// too: points of a mesh, and the elements that touch them.
#pragma once

#include <cstdint>
#include <vector>

namespace novaphy::gpu {

using RowList = std::vector<uint32_t>;

// The part of each row. `needs`: per row, numbers below `count`, which may occur more than once.
// Equal arguments give equal parts.
RowList parts_of(std::vector<RowList> needs, uint32_t count, uint32_t parts);

}  // namespace novaphy::gpu
