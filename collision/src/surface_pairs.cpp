#include "novaphy/collision/surface_pairs.h"

#include <algorithm>
#include <cmath>

#include "box_buckets.h"
#include "novaphy/collision/geometry/nearest_weights.h"

namespace novaphy {
namespace {

using geometry::Box3;
using geometry::Vec3d;

constexpr float kOfRest = 0.9f;  // part of the distance at rest

Vec3d wide(const Vec4f& v) {
  return {static_cast<double>(v.x), static_cast<double>(v.y), static_cast<double>(v.z)};
}

// Features of one kind (vertices, edges or triangles), each given by its particles.
template <size_t n>
struct Features {
  std::vector<std::array<int32_t, n>> corners;
  std::vector<Box3> boxes;
  std::vector<int32_t> worlds;
  std::vector<float> reaches;

  void set_worlds(std::span<const int32_t> world) {
    for (const auto& c : corners) worlds.push_back(world[static_cast<size_t>(c[0])]);
  }
  // Makes the boxes of the features, enlarged on each side by the largest reach of a corner plus
  // `around` (m).
  void set_boxes(std::span<const Vec4f> x, std::span<const float> reach, float around) {
    boxes.resize(corners.size());
    reaches.resize(corners.size());
    for (size_t f = 0; f < corners.size(); ++f) {
      const Vec4f& first = x[static_cast<size_t>(corners[f][0])];
      Box3 box = {{first.x, first.y, first.z}, {first.x, first.y, first.z}};
      float most = 0.0f;
      for (const int32_t p : corners[f]) {
        const Vec4f& v = x[static_cast<size_t>(p)];
        box.lo = {std::min(box.lo.x, v.x), std::min(box.lo.y, v.y), std::min(box.lo.z, v.z)};
        box.hi = {std::max(box.hi.x, v.x), std::max(box.hi.y, v.y), std::max(box.hi.z, v.z)};
        if (!reach.empty()) most = std::max(most, reach[static_cast<size_t>(p)]);
      }
      // The last factor covers the rounding of the ends.
      const float size = std::max({std::abs(box.lo.x), std::abs(box.lo.y), std::abs(box.lo.z),
                                   std::abs(box.hi.x), std::abs(box.hi.y), std::abs(box.hi.z)});
      const float pad = (most + around) * 1.000001f + size * 2e-7f;
      box.lo = box.lo - Vec3f{pad, pad, pad};
      box.hi = box.hi + Vec3f{pad, pad, pad};
      boxes[f] = box;
      reaches[f] = most;
    }
  }
};

template <size_t n, size_t m>
bool share_corner(const std::array<int32_t, n>& a, const std::array<int32_t, m>& b) {
  for (const int32_t p : a)
    for (const int32_t q : b)
      if (p == q) return true;
  return false;
}

// Orders pairs by their particles. The corners of a feature always have the same order, so equal
// particles mean equal features.
bool before(const SurfacePair& a, const SurfacePair& b) {
  return a.has_edges != b.has_edges ? b.has_edges : a.particle < b.particle;
}

geometry::NearestWeights nearest(const SurfacePair& pair, std::span<const Vec4f> x) {
  Vec3d corners[4];
  for (size_t k = 0; k < 4; ++k) corners[k] = wide(x[static_cast<size_t>(pair.particle[k])]);
  return pair.has_edges ? geometry::nearest_of_edges(corners)
                        : geometry::nearest_to_triangle(corners);
}

}  // namespace

struct SurfacePairs::Work {
  Features<1> vertices;
  Features<2> edges;
  Features<3> triangles;
  float radius = 0.0f, shortest = 0.0f;
  std::vector<bool> is_vertex;
  std::vector<SurfacePair> near_at_rest;  // sorted by `before`
  std::vector<SurfacePair> pairs;
  detail::BoxBuckets buckets;
  std::vector<int32_t> met;

  // Adds the pairs of two kinds of features. Each pair of two edges is added once.
  template <size_t n, size_t m>
  void add_pairs(const Features<n>& a, const Features<m>& b, std::span<const Vec4f> x) {
    buckets.build(b.boxes, a.boxes, b.worlds);
    for (size_t i = 0; i < a.corners.size(); ++i) {
      met.clear();
      buckets.visit(a.boxes[i], a.worlds[i], [&](int32_t j) {
        if (n == m && static_cast<size_t>(j) <= i) return;
        if (!share_corner(a.corners[i], b.corners[static_cast<size_t>(j)])) met.push_back(j);
      });
      std::sort(met.begin(), met.end());
      for (const int32_t j : met) {
        SurfacePair pair = {.has_edges = n == 2, .radius = radius};
        for (size_t k = 0; k < n; ++k) pair.particle[k] = a.corners[i][k];
        for (size_t k = 0; k < m; ++k) pair.particle[n + k] = b.corners[static_cast<size_t>(j)][k];
        const float reach = radius + (a.reaches[i] + b.reaches[static_cast<size_t>(j)]);
        if (nearest(pair, x).distance < static_cast<double>(reach) * 1.00001) pairs.push_back(pair);
      }
    }
  }
  void find(std::span<const Vec4f> x, std::span<const float> reach) {
    pairs.clear();
    vertices.set_boxes(x, reach, 0.5f * radius);
    edges.set_boxes(x, reach, 0.5f * radius);
    triangles.set_boxes(x, reach, 0.5f * radius);
    add_pairs(vertices, triangles, x);
    add_pairs(edges, edges, x);
  }
};

SurfacePairs::SurfacePairs(std::span<const Vec3i> triangles, std::span<const int32_t> world,
                           std::span<const Vec3f> rest, float radius)
    : work_(std::make_unique<Work>()) {
  Work& w = *work_;
  w.radius = radius;
  w.is_vertex.assign(rest.size(), false);
  for (const Vec3i& t : triangles) {
    w.triangles.corners.push_back({t.x, t.y, t.z});
    for (const auto& [p, q] : {std::minmax(t.x, t.y), std::minmax(t.y, t.z), std::minmax(t.x, t.z)})
      w.edges.corners.push_back({p, q});
    for (const int32_t p : {t.x, t.y, t.z}) w.is_vertex[static_cast<size_t>(p)] = true;
  }
  auto& edges = w.edges.corners;
  std::sort(edges.begin(), edges.end());
  edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
  for (size_t p = 0; p < rest.size(); ++p)
    if (w.is_vertex[p]) w.vertices.corners.push_back({static_cast<int32_t>(p)});
  w.vertices.set_worlds(world);
  w.edges.set_worlds(world);
  w.triangles.set_worlds(world);

  std::vector<Vec4f> x;
  for (const Vec3f& v : rest) x.push_back({v.x, v.y, v.z, 0.0f});
  for (const auto& [p, q] : edges) {
    const float length = math::length(rest[static_cast<size_t>(p)] - rest[static_cast<size_t>(q)]);
    w.shortest = w.shortest == 0.0f ? length : std::min(w.shortest, length);
  }
  w.find(x, {});
  for (SurfacePair& pair : w.pairs)
    pair.radius = kOfRest * static_cast<float>(nearest(pair, x).distance);
  w.near_at_rest = w.pairs;
  std::sort(w.near_at_rest.begin(), w.near_at_rest.end(), before);
}

SurfacePairs::~SurfacePairs() = default;

const std::vector<SurfacePair>& SurfacePairs::find(std::span<const Vec4f> x,
                                                   std::span<const float> reach) {
  Work& w = *work_;
  w.find(x, reach);
  if (w.near_at_rest.empty()) return w.pairs;
  for (SurfacePair& pair : w.pairs) {
    const auto at = std::lower_bound(w.near_at_rest.begin(), w.near_at_rest.end(), pair, before);
    if (at != w.near_at_rest.end() && !before(pair, *at)) pair.radius = at->radius;
  }
  return w.pairs;
}

std::optional<std::array<int32_t, 5>> SurfacePairs::find_crossing(std::span<const Vec4f> x) {
  Work& w = *work_;
  w.edges.set_boxes(x, {}, 0.0f);
  w.triangles.set_boxes(x, {}, 0.0f);
  w.buckets.build(w.triangles.boxes, w.edges.boxes, w.triangles.worlds);
  const auto at = [&](int32_t p) { return wide(x[static_cast<size_t>(p)]); };
  for (size_t e = 0; e < w.edges.corners.size(); ++e) {
    const auto& [p, q] = w.edges.corners[e];
    int32_t crossed = -1;
    w.buckets.visit(w.edges.boxes[e], w.edges.worlds[e], [&](int32_t t) {
      const auto& of = w.triangles.corners[static_cast<size_t>(t)];
      if (share_corner(w.edges.corners[e], of) || (crossed >= 0 && crossed < t)) return;
      if (geometry::passes_through(at(p), at(q), at(of[0]), at(of[1]), at(of[2]))) crossed = t;
    });
    if (crossed < 0) continue;
    const auto& of = w.triangles.corners[static_cast<size_t>(crossed)];
    return std::array<int32_t, 5>{p, q, of[0], of[1], of[2]};
  }
  return {};
}

bool SurfacePairs::is_vertex(int32_t particle) const {
  return work_->is_vertex[static_cast<size_t>(particle)];
}
float SurfacePairs::shortest_edge() const { return work_->shortest; }

}  // namespace novaphy
