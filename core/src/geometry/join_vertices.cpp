#include "novaphy/core/geometry/join_vertices.h"

#include <bit>

namespace novaphy {

std::vector<int32_t> first_in_place(std::span<const Vec3f> vertices) {
  // A table of the first ones, at most half full.
  const size_t size = std::bit_ceil(2 * vertices.size() + 1);
  std::vector<int32_t> table(size, -1), first(vertices.size());
  const auto bits = [](float x) {
    return uint64_t{std::bit_cast<uint32_t>(x + 0.0f)};
  };  // of -0: 0
  for (size_t i = 0; i < vertices.size(); ++i) {
    const Vec3f& v = vertices[i];
    uint64_t hash = (bits(v.x) * 0x9E3779B97F4A7C15u) ^ (bits(v.y) * 0xC2B2AE3D27D4EB4Fu) ^
                    (bits(v.z) * 0x165667B19E3779F9u);
    hash = (hash ^ (hash >> 32)) * 0xD6E8FEB86659FD93u;
    size_t at = (hash ^ (hash >> 32)) & (size - 1);
    const auto is_here = [&](int32_t k) {
      const Vec3f& other = vertices[static_cast<size_t>(k)];
      return other.x == v.x && other.y == v.y && other.z == v.z;
    };
    while (table[at] >= 0 && !is_here(table[at])) at = (at + 1) & (size - 1);
    if (table[at] < 0) table[at] = static_cast<int32_t>(i);
    first[i] = table[at];
  }
  return first;
}

}  // namespace novaphy
