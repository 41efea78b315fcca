// Finds pairs of features that come near each other on moving surfaces: a vertex and a triangle, or
// two edges. A surface is a set of triangles whose corners are particles.
//
// Two features with a common particle, or of two different worlds, are not a pair. Particles of
// world -1 belong to all worlds.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "novaphy/collision/export.h"
#include "novaphy/collision/geometry/mesh_view.h"
#include "novaphy/math/types.h"

namespace novaphy {

// The particles of a pair: a vertex and the corners of a triangle, or the ends of two edges.
struct SurfacePair {
  std::array<int32_t, 4> particle{};
  bool has_edges = false;
  float radius = 0.0f;    // m: contacts begin at this distance
  float distance = 0.0f;  // m: distance of the features when the pair was found

  // Returns whether the k-th particle belongs to the first feature.
  bool is_first(int k) const { return k < (has_edges ? 2 : 1); }
};

class NOVAPHY_COLLISION_API SurfacePairs {
 public:
  // `world` and `rest` have a row for each particle. If the features of a pair are nearer than
  // `radius` (m) in the rest positions, the radius of the pair is 0.9 times this distance.
  SurfacePairs(std::span<const Vec3i> triangles, std::span<const int32_t> world,
               std::span<const Vec3f> rest, float radius);
  ~SurfacePairs();

  // Returns the pairs that can come nearer than their radius if each particle moves by at most its
  // `reach` (m) from x. With `regions` each particle also stays in its region. Pairs of vertices
  // and triangles come first, then pairs of edges, both in the order of the triangles of their
  // features. The fourth float of a row of `x` is not used.
  const std::vector<SurfacePair>& find(std::span<const Vec4f> x, std::span<const float> reach,
                                       std::span<const geometry::Box3> regions = {});

  // Returns the ends of an edge that passes through a triangle at the positions x, and the
  // triangle's corners. Empty: no edge passes.
  std::optional<std::array<int32_t, 5>> find_crossing(std::span<const Vec4f> x);

  // Returns whether a particle is a corner of a triangle.
  bool is_vertex(int32_t particle) const;
  // Returns the length of the shortest edge in the rest positions (m), or 0 without an edge.
  float shortest_edge() const;

 private:
  struct Work;
  std::unique_ptr<Work> work_;
};

}  // namespace novaphy
