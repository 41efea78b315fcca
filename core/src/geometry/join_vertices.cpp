#include "novaphy/core/geometry/join_vertices.h"

#include <bit>

namespace novaphy {

std::vector<int32_t> first_at_position(std::span<const Vec3f> vertices) {
  std::vector<int32_t> first(vertices.size());
  // An open-addressing hash table of vertex indices, at most half full.
  std::vector<int32_t> table(std::bit_ceil(2 * vertices.size() + 1), -1);
  const size_t mask = table.size() - 1;
  for (size_t i = 0; i < vertices.size(); ++i) {
    const Vec3f& v = vertices[i];
    uint64_t hash = 0;
    for (const float x : {v.x, v.y, v.z}) {  // adding 0 maps -0 to 0
      hash = (hash ^ std::bit_cast<uint32_t>(x + 0.0f)) * 0x9E3779B97F4A7C15u;
      hash ^= hash >> 32;
    }
    size_t at = hash & mask;
    while (table[at] >= 0 && !(vertices[static_cast<size_t>(table[at])] == v)) at = (at + 1) & mask;
    if (table[at] < 0) table[at] = static_cast<int32_t>(i);
    first[i] = table[at];
  }
  return first;
}

}  // namespace novaphy
