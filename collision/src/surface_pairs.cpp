#include "novaphy/collision/surface_pairs.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "box_tree.h"
#include "novaphy/collision/geometry/nearest_weights.h"
#include "novaphy/core/sim/for_chunks.h"

namespace novaphy {
namespace {

using geometry::Box3;
using geometry::Vec3d;

constexpr float kOfRest = 0.9f;  // part of the distance at rest
constexpr int64_t kChunk = 64;   // triangles that a thread takes at once

Vec3d wide(const Vec4f& v) {
  return {static_cast<double>(v.x), static_cast<double>(v.y), static_cast<double>(v.z)};
}

// Returns a box with all points nearer to `box` than `around` (m). The last term covers rounding.
Box3 padded(const Box3& box, float around) {
  const float size = std::max({std::abs(box.lo.x), std::abs(box.lo.y), std::abs(box.lo.z),
                               std::abs(box.hi.x), std::abs(box.hi.y), std::abs(box.hi.z)});
  const float pad = around * 1.000001f + size * 2e-7f;
  return {box.lo - Vec3f{pad, pad, pad}, box.hi + Vec3f{pad, pad, pad}};
}

// Features of one kind (vertices, edges or triangles), given by their particles.
template <size_t n>
struct Features {
  std::vector<std::array<int32_t, n>> corners;
  std::vector<Box3> boxes;
  std::vector<float> reaches;

  // `of`: the box of each particle.
  void set_boxes(std::span<const Box3> of, std::span<const float> reach) {
    boxes.resize(corners.size());
    reaches.assign(corners.size(), 0.0f);
    for (size_t f = 0; f < corners.size(); ++f) {
      boxes[f] = of[static_cast<size_t>(corners[f][0])];
      for (const int32_t p : corners[f]) {
        boxes[f] = detail::united(boxes[f], of[static_cast<size_t>(p)]);
        if (!reach.empty()) reaches[f] = std::max(reaches[f], reach[static_cast<size_t>(p)]);
      }
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

// Orders pairs by their particles. The corners of a feature always have the same order, so that
// equal particles mean equal features.
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
  // The vertices and edges of a triangle that no earlier triangle has.
  struct Owned {
    int32_t vertices[3], edges[3];
    int vertex_count = 0, edge_count = 0;
  };
  Features<1> vertices;
  Features<2> edges;
  Features<3> triangles;
  std::vector<int32_t> worlds;  // of each triangle
  std::vector<Owned> owned;     // of each triangle
  float radius = 0.0f, shortest = 0.0f;
  std::vector<bool> is_vertex;
  std::vector<SurfacePair> near_at_rest;  // sorted by `before`
  std::vector<SurfacePair> pairs;
  detail::BoxTree tree;  // of triangles
  std::vector<Box3> of_particles;
  struct Chunk {
    std::vector<SurfacePair> pairs, of_edges;
    std::vector<int32_t> met;
  };
  std::vector<Chunk> chunks;  // of triangles

  void add_triangles(std::span<const Vec3i> of, std::span<const int32_t> world) {
    std::map<std::array<int32_t, 2>, int32_t> numbers;
    for (const Vec3i& t : of) {
      Owned& owns = owned.emplace_back();
      for (const int32_t p : {t.x, t.y, t.z}) {
        if (is_vertex[static_cast<size_t>(p)]) continue;
        is_vertex[static_cast<size_t>(p)] = true;
        owns.vertices[owns.vertex_count++] = static_cast<int32_t>(vertices.corners.size());
        vertices.corners.push_back({p});
      }
      for (const auto& [p, q] :
           {std::minmax(t.x, t.y), std::minmax(t.y, t.z), std::minmax(t.x, t.z)}) {
        const auto next = static_cast<int32_t>(edges.corners.size());
        if (!numbers.try_emplace({p, q}, next).second) continue;
        owns.edges[owns.edge_count++] = next;
        edges.corners.push_back({p, q});
      }
      triangles.corners.push_back({t.x, t.y, t.z});
      worlds.push_back(world[static_cast<size_t>(t.x)]);
    }
  }
  void set_boxes(std::span<const Vec4f> x, std::span<const float> reach,
                 std::span<const Box3> regions, float around) {
    of_particles.resize(x.size());
    for (const auto& [p] : vertices.corners) {
      const auto i = static_cast<size_t>(p);
      const Vec3f v = {x[i].x, x[i].y, x[i].z};
      if (regions.empty()) {
        of_particles[i] = padded({v, v}, around + (reach.empty() ? 0.0f : reach[i]));
      } else {
        of_particles[i] = padded(regions[i], around);
      }
    }
    vertices.set_boxes(of_particles, reach);
    edges.set_boxes(of_particles, reach);
    triangles.set_boxes(of_particles, reach);
  }
  template <size_t n, size_t m>
  void try_pair(const Features<n>& of_a, int32_t a, const Features<m>& of_b, int32_t b,
                std::span<const Vec4f> x, Chunk& to) const {
    const auto i = static_cast<size_t>(a), j = static_cast<size_t>(b);
    if (!geometry::boxes_meet(of_a.boxes[i], of_b.boxes[j])) return;
    if (share_corner(of_a.corners[i], of_b.corners[j])) return;
    SurfacePair pair = {.has_edges = n == 2, .radius = radius};
    for (size_t k = 0; k < n; ++k) pair.particle[k] = of_a.corners[i][k];
    for (size_t k = 0; k < m; ++k) pair.particle[n + k] = of_b.corners[j][k];
    const float most = (radius + (of_a.reaches[i] + of_b.reaches[j])) * 1.00001f;
    pair.distance = static_cast<float>(nearest(pair, x).distance);
    if (pair.distance < most) (n == 2 ? to.of_edges : to.pairs).push_back(pair);
  }
  // Two features can meet only if the boxes of the triangles that own them overlap. Each pair of
  // triangles is visited once. Each pair of features is therefore visited once, too.
  void find(std::span<const Vec4f> x, std::span<const float> reach, std::span<const Box3> regions) {
    set_boxes(x, reach, regions, 0.5f * radius);
    tree.fit(triangles.boxes);
    const auto count = static_cast<int64_t>(owned.size());
    chunks.resize(static_cast<size_t>(chunk_count(count, kChunk)));
    for_chunks(count, kChunk, [&](int64_t begin, int64_t end, int64_t chunk) {
      Chunk& to = chunks[static_cast<size_t>(chunk)];
      to.pairs.clear();
      to.of_edges.clear();
      for (int64_t s = begin; s < end; ++s) find_of(static_cast<int32_t>(s), x, to);
    });
    pairs.clear();
    for (const Chunk& c : chunks) pairs.insert(pairs.end(), c.pairs.begin(), c.pairs.end());
    for (const Chunk& c : chunks) pairs.insert(pairs.end(), c.of_edges.begin(), c.of_edges.end());
  }
  void find_of(int32_t s, std::span<const Vec4f> x, Chunk& to) const {
    const auto i = static_cast<size_t>(s);
    to.met.clear();
    tree.visit(triangles.boxes[i], worlds[i], s + 1, [&](int32_t t) {
      if (t > s) to.met.push_back(t);
    });
    std::sort(to.met.begin(), to.met.end());
    for (const int32_t t : to.met) {
      const Owned &a = owned[i], &b = owned[static_cast<size_t>(t)];
      for (int k = 0; k < a.vertex_count; ++k)
        try_pair(vertices, a.vertices[k], triangles, t, x, to);
      for (int k = 0; k < b.vertex_count; ++k)
        try_pair(vertices, b.vertices[k], triangles, s, x, to);
      for (int k = 0; k < a.edge_count; ++k)
        for (int l = 0; l < b.edge_count; ++l)
          try_pair(edges, a.edges[k], edges, b.edges[l], x, to);
    }
  }
};

SurfacePairs::SurfacePairs(std::span<const Vec3i> triangles, std::span<const int32_t> world,
                           std::span<const Vec3f> rest, float radius)
    : work_(std::make_unique<Work>()) {
  Work& w = *work_;
  w.radius = radius;
  w.is_vertex.assign(rest.size(), false);
  w.add_triangles(triangles, world);
  std::vector<Vec3f> corners;
  for (const Vec3i& t : triangles) corners.push_back(rest[static_cast<size_t>(t.x)]);
  w.tree.build(corners, w.worlds);

  std::vector<Vec4f> x;
  for (const Vec3f& v : rest) x.push_back({v.x, v.y, v.z, 0.0f});
  for (const auto& [p, q] : w.edges.corners) {
    const float length = math::length(rest[static_cast<size_t>(p)] - rest[static_cast<size_t>(q)]);
    w.shortest = w.shortest == 0.0f ? length : std::min(w.shortest, length);
  }
  w.find(x, {}, {});
  for (SurfacePair& pair : w.pairs) pair.radius = kOfRest * pair.distance;
  w.near_at_rest = w.pairs;
  std::sort(w.near_at_rest.begin(), w.near_at_rest.end(), before);
}

SurfacePairs::~SurfacePairs() = default;

const std::vector<SurfacePair>& SurfacePairs::find(std::span<const Vec4f> x,
                                                   std::span<const float> reach,
                                                   std::span<const Box3> regions) {
  Work& w = *work_;
  w.find(x, reach, regions);
  if (w.near_at_rest.empty()) return w.pairs;
  for (SurfacePair& pair : w.pairs) {
    const auto at = std::lower_bound(w.near_at_rest.begin(), w.near_at_rest.end(), pair, before);
    if (at != w.near_at_rest.end() && !before(pair, *at)) pair.radius = at->radius;
  }
  return w.pairs;
}

std::optional<std::array<int32_t, 5>> SurfacePairs::find_crossing(std::span<const Vec4f> x) {
  Work& w = *work_;
  w.set_boxes(x, {}, {}, 0.0f);
  w.tree.fit(w.triangles.boxes);
  const auto at = [&](int32_t p) { return wide(x[static_cast<size_t>(p)]); };
  for (size_t of = 0; of < w.owned.size(); ++of)
    for (int k = 0; k < w.owned[of].edge_count; ++k) {
      const auto e = static_cast<size_t>(w.owned[of].edges[k]);
      const auto& [p, q] = w.edges.corners[e];
      int32_t crossed = -1;
      w.tree.visit(w.edges.boxes[e], w.worlds[of], 0, [&](int32_t t) {
        const auto& [a, b, c] = w.triangles.corners[static_cast<size_t>(t)];
        if (share_corner(w.edges.corners[e], w.triangles.corners[static_cast<size_t>(t)])) return;
        if (crossed >= 0 && crossed < t) return;
        if (geometry::passes_through(at(p), at(q), at(a), at(b), at(c))) crossed = t;
      });
      if (crossed < 0) continue;
      const auto& [a, b, c] = w.triangles.corners[static_cast<size_t>(crossed)];
      return std::array<int32_t, 5>{p, q, a, b, c};
    }
  return {};
}

bool SurfacePairs::is_vertex(int32_t particle) const {
  return work_->is_vertex[static_cast<size_t>(particle)];
}
float SurfacePairs::shortest_edge() const { return work_->shortest; }

}  // namespace novaphy
