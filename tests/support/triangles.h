// Triangle meshes for tests.
#pragma once

#include <cstdint>
#include <vector>

#include "novaphy/math/types.h"

namespace novaphy::testing {

struct Triangles {
  std::vector<Vec3f> vertices;
  std::vector<int32_t> indices;
};

// A box of half extents hx, hy, hz.
inline Triangles box(float hx, float hy, float hz) {
  Triangles t;
  for (int i = 0; i < 8; ++i)
    t.vertices.push_back({i & 1 ? hx : -hx, i & 2 ? hy : -hy, i & 4 ? hz : -hz});
  t.indices = {0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4,
               2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5};
  return t;
}
inline Triangles cube(float h) { return box(h, h, h); }

// n x n squares of side `cell` about the origin, cut along alternating diagonals.
template <class Height>
Triangles terrain(int n, float cell, Height height) {
  Triangles t;
  const auto at = [&](int i) {
    return cell * (static_cast<float>(i) - 0.5f * static_cast<float>(n));
  };
  for (int j = 0; j <= n; ++j)
    for (int i = 0; i <= n; ++i) t.vertices.push_back({at(i), at(j), height(at(i), at(j))});
  for (int j = 0; j < n; ++j)
    for (int i = 0; i < n; ++i) {
      const int a = j * (n + 1) + i, b = a + 1, c = a + n + 1, d = c + 1;
      if ((i + j) % 2 == 0)
        t.indices.insert(t.indices.end(), {a, b, d, a, d, c});
      else
        t.indices.insert(t.indices.end(), {a, b, c, b, d, c});
    }
  return t;
}
inline float flat(float, float) { return 0.0f; }

}  // namespace novaphy::testing
