// Divides rows into parts that have few needs in common. The rows are points of a mesh, and their
// needs are the elements that touch them. Neighboring points have needs in common.
#pragma once

#include <cstdint>
#include <vector>

namespace novaphy::gpu {

using RowList = std::vector<uint32_t>;

// Returns the part of each row. `needs` has for each row numbers below `count`, possibly repeated.
// Equal arguments give equal parts.
RowList parts_of(std::vector<RowList> needs, uint32_t count, uint32_t parts);

}  // namespace novaphy::gpu
