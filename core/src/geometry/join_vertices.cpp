#include "novaphy/core/geometry/join_vertices.h"

#include <algorithm>
#include <numeric>
#include <tuple>

namespace novaphy {

std::vector<int32_t> first_in_place(std::span<const Vec3f> vertices) {
  std::vector<int32_t> order(vertices.size()), first(vertices.size());
  std::iota(order.begin(), order.end(), 0);
  const auto key = [&](int32_t i) {
    const Vec3f& v = vertices[static_cast<size_t>(i)];
    return std::tuple(v.x, v.y, v.z);
  };
  std::sort(order.begin(), order.end(),
            [&](int32_t a, int32_t b) { return key(a) != key(b) ? key(a) < key(b) : a < b; });
  for (size_t i = 0; i < order.size(); ++i) {
    const bool same = i > 0 && key(order[i]) == key(order[i - 1]);
    first[static_cast<size_t>(order[i])] =
        same ? first[static_cast<size_t>(order[i - 1])] : order[i];
  }
  return first;
}

}  // namespace novaphy
