// Divides rows into parts that share few inputs ("needs" in the code). The rows are points of a
// mesh, and the inputs of a point are the elements that touch the point. Neighboring points share
// inputs.
#pragma once

#include <cstdint>
#include <vector>

namespace novaphy::gpu {

using RowList = std::vector<uint32_t>;

// Returns the part of each row. `needs` has for each row numbers below `count`, possibly repeated.
// Equal arguments give equal parts.
RowList parts_of(std::vector<RowList> needs, uint32_t count, uint32_t parts);

}  // namespace novaphy::gpu
