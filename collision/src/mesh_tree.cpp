#include "novaphy/collision/mesh_tree.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <tuple>
#include <utility>

#include "novaphy/core/error.h"
#include "novaphy/core/geometry/join_vertices.h"

namespace novaphy {
namespace {

using geometry::Box3;
using geometry::MeshNode;
using Vec3d = Vec3<double>;

constexpr int32_t kLeafTriangles = 4;

Vec3d widen(const Vec3f& v) { return {v.x, v.y, v.z}; }
Vec3d unit(const Vec3d& v) {
  const double l = std::sqrt(math::dot(v, v));
  return l > 0.0 ? v * (1.0 / l) : Vec3d{};
}

void check(std::span<const Vec3f> vertices, std::span<const int32_t> indices) {
  require(!indices.empty() && indices.size() % 3 == 0, ErrorKind::Value,
          "build_mesh_tree: indices: expected 3 per triangle, got ", indices.size());
  for (size_t i = 0; i < vertices.size(); ++i)
    require(geometry::is_finite(vertices[i]), ErrorKind::Value, "build_mesh_tree: vertices[", i,
            "]: expected finite numbers, got (", vertices[i].x, ", ", vertices[i].y, ", ",
            vertices[i].z, ")");
  for (size_t i = 0; i < indices.size(); ++i)
    require(indices[i] >= 0 && static_cast<size_t>(indices[i]) < vertices.size(), ErrorKind::Value,
            "build_mesh_tree: indices[", i, "]: expected 0 to ", vertices.size(),
            " (exclusive), got ", indices[i]);
}

void set_rings(MeshTree& tree) {
  std::vector<std::pair<int32_t, int32_t>> edges;
  edges.reserve(6 * tree.triangles.size());
  for (const Vec3i& t : tree.triangles)
    for (const auto& [i, j] : {std::pair{t.x, t.y}, std::pair{t.y, t.z}, std::pair{t.z, t.x}}) {
      edges.push_back({i, j});
      edges.push_back({j, i});
    }
  std::sort(edges.begin(), edges.end());
  edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
  tree.ring_starts.assign(tree.vertices.size() + 1, 0);
  for (const auto& [i, j] : edges) {
    ++tree.ring_starts[static_cast<size_t>(i) + 1];
    tree.ring.push_back(j);
  }
  std::partial_sum(tree.ring_starts.begin(), tree.ring_starts.end(), tree.ring_starts.begin());
}

// Where more than two triangles meet, or two with opposite sides, each has a border. Triangles
// without area have no edges, but what they touch is unclear.
void set_edges(MeshTree& tree) {
  constexpr float kConvexSine = 1e-3f;
  struct Side {
    int32_t a, b, triangle, corner;  // a, b: as the triangle goes round
    bool is_empty;                   // of a triangle without area
  };
  std::vector<Side> sides;
  for (size_t t = 0; t < tree.triangles.size(); ++t) {
    const Vec3i& c = tree.triangles[t];
    const bool is_empty = tree.normals[t] == Vec3f{};
    const auto triangle = static_cast<int32_t>(t);
    sides.insert(sides.end(), {{c.x, c.y, triangle, 0, is_empty},
                               {c.y, c.z, triangle, 1, is_empty},
                               {c.z, c.x, triangle, 2, is_empty}});
  }
  const auto key = [](const Side& s) {
    return std::tuple(std::min(s.a, s.b), std::max(s.a, s.b), s.is_empty, s.triangle);
  };
  std::sort(sides.begin(), sides.end(),
            [&](const Side& s, const Side& other) { return key(s) < key(other); });
  const auto third = [&](const Side& s) {
    const Vec3i& c = tree.triangles[static_cast<size_t>(s.triangle)];
    return s.corner == 0 ? c.z : s.corner == 1 ? c.x : c.y;
  };
  const auto of_side = [](std::vector<Vec3i>& table, const Side& s) -> int32_t& {
    Vec3i& row = table[static_cast<size_t>(s.triangle)];
    return s.corner == 0 ? row.x : s.corner == 1 ? row.y : row.z;
  };
  tree.own_edges.assign(tree.triangles.size(), {-1, -1, -1});
  tree.across.assign(tree.triangles.size(),
                     {geometry::kMeshUnclear, geometry::kMeshUnclear, geometry::kMeshUnclear});
  const auto add = [&](const Side& s, int32_t right) {
    of_side(tree.own_edges, s) = static_cast<int32_t>(tree.edges.size());
    tree.edges.push_back({s.a, s.b, third(s), right, s.triangle});
  };
  for (size_t i = 0, end = 0; i < sides.size(); i = end) {
    size_t full = i;  // behind those of triangles with an area
    for (end = i; end < sides.size() &&
                  std::min(sides[end].a, sides[end].b) == std::min(sides[i].a, sides[i].b) &&
                  std::max(sides[end].a, sides[end].b) == std::max(sides[i].a, sides[i].b);
         ++end)
      if (!sides[end].is_empty) full = end + 1;
    if (end == i + 1) of_side(tree.across, sides[i]) = geometry::kMeshBorder;
    if (full == i + 2 && sides[i].a == sides[i + 1].b) {
      const int32_t right = third(sides[i + 1]);
      if (end == full) {
        of_side(tree.across, sides[i]) = right;
        of_side(tree.across, sides[i + 1]) = third(sides[i]);
      }
      const Vec3f d = tree.vertices[static_cast<size_t>(right)] -
                      tree.vertices[static_cast<size_t>(sides[i].a)];
      const Vec3f& n = tree.normals[static_cast<size_t>(sides[i].triangle)];
      if (math::dot(n, d) < -kConvexSine * math::length(d)) add(sides[i], right);
      continue;
    }
    for (size_t k = i; k < full; ++k) add(sides[k], -1);
  }
}

class Builder {
 public:
  explicit Builder(MeshTree& tree) : tree_(tree) {
    for (const Vec3i& t : tree.triangles) {
      Box3 box{vertex(t.x), vertex(t.x)};
      for (const int32_t i : {t.y, t.z}) grow(box, {vertex(i), vertex(i)});
      boxes_.push_back(box);
      centres_.push_back((widen(box.lo) + widen(box.hi)) * 0.5);
    }
    tree_.order.resize(tree.triangles.size());
    std::iota(tree_.order.begin(), tree_.order.end(), 0);
    add(0, tree_.order.size());
  }

 private:
  const Vec3f& vertex(int32_t i) const { return tree_.vertices[static_cast<size_t>(i)]; }
  static void grow(Box3& box, const Box3& other) {
    box.lo = {std::min(box.lo.x, other.lo.x), std::min(box.lo.y, other.lo.y),
              std::min(box.lo.z, other.lo.z)};
    box.hi = {std::max(box.hi.x, other.hi.x), std::max(box.hi.y, other.hi.y),
              std::max(box.hi.z, other.hi.z)};
  }
  double centre(int32_t triangle, int axis) const {
    const Vec3d& c = centres_[static_cast<size_t>(triangle)];
    return axis == 0 ? c.x : axis == 1 ? c.y : c.z;
  }
  int longest_axis(size_t begin, size_t end) const {
    int best = 0;
    double longest = -1.0;
    for (int axis = 0; axis < 3; ++axis) {
      double lo = centre(tree_.order[begin], axis), hi = lo;
      for (size_t i = begin; i < end; ++i) {
        lo = std::min(lo, centre(tree_.order[i], axis));
        hi = std::max(hi, centre(tree_.order[i], axis));
      }
      if (hi - lo > longest) {
        longest = hi - lo;
        best = axis;
      }
    }
    return best;
  }
  // The node of order[begin .. end), and all below it: depth is the logarithm of the triangles.
  void add(size_t begin, size_t end) {
    const size_t node = tree_.nodes.size();
    Box3 box = boxes_[static_cast<size_t>(tree_.order[begin])];
    for (size_t i = begin; i < end; ++i) grow(box, boxes_[static_cast<size_t>(tree_.order[i])]);
    const bool leaf = end - begin <= kLeafTriangles;
    tree_.nodes.push_back(
        {box, 0, static_cast<int32_t>(begin), leaf ? static_cast<int32_t>(end - begin) : 0});
    if (!leaf) {
      const int axis = longest_axis(begin, end);
      const size_t middle = begin + (end - begin) / 2;
      const auto first = tree_.order.begin();
      std::nth_element(first + static_cast<int64_t>(begin), first + static_cast<int64_t>(middle),
                       first + static_cast<int64_t>(end), [&](int32_t a, int32_t b) {
                         const double x = centre(a, axis), y = centre(b, axis);
                         return x != y ? x < y : a < b;
                       });
      // Which half a triangle is in is determined; within it, by index.
      std::sort(first + static_cast<int64_t>(begin), first + static_cast<int64_t>(middle));
      std::sort(first + static_cast<int64_t>(middle), first + static_cast<int64_t>(end));
      add(begin, middle);
      add(middle, end);
    }
    tree_.nodes[node].skip = static_cast<int32_t>(tree_.nodes.size());
  }

  MeshTree& tree_;
  std::vector<Box3> boxes_;
  std::vector<Vec3d> centres_;
};

// The box of the mesh. With a border, it goes on behind the triangles as far as the mesh is large.
void set_behind(MeshTree& tree) {
  Box3& box = tree.behind;
  box = tree.nodes[0].box;
  const float size = math::length(box.hi - box.lo);
  const auto has_border = [](const Vec3i& across) {
    constexpr int32_t kBorder = geometry::kMeshBorder;
    return across.x == kBorder || across.y == kBorder || across.z == kBorder;
  };
  if (std::none_of(tree.across.begin(), tree.across.end(), has_border)) return;
  Vec3f lo{}, hi{};  // of the normals
  for (const Vec3f& n : tree.normals) {
    lo = {std::min(lo.x, n.x), std::min(lo.y, n.y), std::min(lo.z, n.z)};
    hi = {std::max(hi.x, n.x), std::max(hi.y, n.y), std::max(hi.z, n.z)};
  }
  const auto grow = [size](bool is_behind) { return is_behind ? size : 0.0f; };
  box.lo = box.lo - Vec3f{grow(hi.x > 0.0f), grow(hi.y > 0.0f), grow(hi.z > 0.0f)};
  box.hi = box.hi + Vec3f{grow(lo.x < 0.0f), grow(lo.y < 0.0f), grow(lo.z < 0.0f)};
}

}  // namespace

geometry::MeshView mesh_view(const MeshTree& tree) {
  geometry::MeshView view;
  view.vertices = tree.vertices.data();
  view.triangles = tree.triangles.data();
  view.normals = tree.normals.data();
  view.ring_starts = tree.ring_starts.data();
  view.ring = tree.ring.data();
  view.edges = tree.edges.data();
  view.own_edges = tree.own_edges.data();
  view.across = tree.across.data();
  view.nodes = tree.nodes.data();
  view.order = tree.order.data();
  view.behind = tree.behind;
  view.node_count = static_cast<int32_t>(tree.nodes.size());
  view.vertex_count = static_cast<int32_t>(tree.vertices.size());
  view.edge_count = static_cast<int32_t>(tree.edges.size());
  for (const geometry::MeshEdge& e : tree.edges)
    view.longest_edge =
        std::max(view.longest_edge, math::length(tree.vertices[static_cast<size_t>(e.b)] -
                                                 tree.vertices[static_cast<size_t>(e.a)]));
  return view;
}

MeshTree build_mesh_tree(std::span<const Vec3f> vertices, std::span<const int32_t> indices) {
  check(vertices, indices);
  MeshTree tree;
  tree.vertices.assign(vertices.begin(), vertices.end());
  const std::vector<int32_t> place = first_in_place(tree.vertices);
  auto joined = [&](size_t i) { return place[static_cast<size_t>(indices[i])]; };
  for (size_t i = 0; i + 2 < indices.size(); i += 3)
    tree.triangles.push_back({joined(i), joined(i + 1), joined(i + 2)});
  auto at = [&](int32_t i) { return widen(tree.vertices[static_cast<size_t>(i)]); };
  for (const Vec3i& t : tree.triangles) {
    const Vec3d n = unit(math::cross(at(t.y) - at(t.x), at(t.z) - at(t.x)));
    tree.normals.push_back(
        {static_cast<float>(n.x), static_cast<float>(n.y), static_cast<float>(n.z)});
  }
  set_rings(tree);
  set_edges(tree);
  Builder{tree};
  set_behind(tree);
  return tree;
}

}  // namespace novaphy
