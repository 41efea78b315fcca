// Partitions rows so that the parts need little in common, if neighboring rows have needs in
// common: points of a mesh, and the elements that touch them.
#pragma once

#include <cstdint>
#include <vector>

namespace novaphy::gpu {

using RowList = std::vector<uint32_t>;

// Returns the part of each row. `needs`: for each row, numbers below `count`, possibly repeated.
// Equal arguments give equal parts.
RowList parts_of(std::vector<RowList> needs, uint32_t count, uint32_t parts);

}  // namespace novaphy::gpu
