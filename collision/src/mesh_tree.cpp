#include "novaphy/collision/mesh_tree.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <numeric>
#include <tuple>
#include <utility>

#include "novaphy/core/error.h"
#include "novaphy/core/geometry/join_vertices.h"
#include "novaphy/core/sim/index_rows.h"

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

// Returns the items 0 to count - 1 as rows of IndexRows: row r has the items with key r. Keys are
// less than `keys`.
template <class KeyOf>
IndexRows rows_by(size_t keys, size_t count, KeyOf key_of) {
  std::vector<int32_t> all(count);
  for (size_t i = 0; i < count; ++i) all[i] = key_of(i);
  IndexRows rows;
  rows.build(all, static_cast<int32_t>(keys));
  return rows;
}

// Returns the vertex index of the corner `corner` % 3 of a triangle. Side k of the mesh goes from
// corner k % 3 of triangle k / 3 to the next corner.
int32_t corner_of(const MeshTree& tree, size_t triangle, size_t corner) {
  const Vec3i& t = tree.triangles[triangle];
  return corner % 3 == 0 ? t.x : corner % 3 == 1 ? t.y : t.z;
}

void set_rings(MeshTree& tree) {
  // The neighbors of a corner are both other corners of its triangle.
  const auto from = [&](size_t k) { return corner_of(tree, k / 6, k / 2 % 3); };
  const auto to = [&](size_t k) { return corner_of(tree, k / 6, k / 2 % 3 + 1 + k % 2); };
  const IndexRows rows = rows_by(tree.vertices.size(), 6 * tree.triangles.size(), from);
  tree.ring_starts = {0};
  tree.ring.clear();
  for (size_t v = 0; v < tree.vertices.size(); ++v) {
    const auto first = static_cast<std::ptrdiff_t>(tree.ring.size());
    for (const int32_t k : rows.items(static_cast<int64_t>(v)))
      tree.ring.push_back(to(static_cast<size_t>(k)));
    std::sort(tree.ring.begin() + first, tree.ring.end());
    tree.ring.erase(std::unique(tree.ring.begin() + first, tree.ring.end()), tree.ring.end());
    tree.ring_starts.push_back(static_cast<int32_t>(tree.ring.size()));
  }
}

struct Side {
  int32_t a, b, triangle, corner;  // a, b: in the orientation of the triangle
  bool is_empty;                   // a side of a triangle without area
};

// Returns the sides. Sides of the same edge are consecutive, and those of triangles with area come
// first.
std::vector<Side> sorted_sides(const MeshTree& tree) {
  const auto side = [&](size_t k) {
    const size_t t = k / 3, corner = k % 3;
    return Side{corner_of(tree, t, corner), corner_of(tree, t, corner + 1), static_cast<int32_t>(t),
                static_cast<int32_t>(corner), tree.normals[t] == Vec3f{}};
  };
  const auto key = [](const Side& s) {
    return std::tuple(std::min(s.a, s.b), std::max(s.a, s.b), s.is_empty, s.triangle);
  };
  std::vector<Side> sides(3 * tree.triangles.size());
  const auto least = [&](size_t k) {
    return std::min(corner_of(tree, k / 3, k % 3), corner_of(tree, k / 3, k % 3 + 1));
  };
  const IndexRows rows = rows_by(tree.vertices.size(), sides.size(), least);
  for (size_t k = 0; k < sides.size(); ++k) sides[k] = side(static_cast<size_t>(rows.all()[k]));
  for (size_t v = 0; v < tree.vertices.size(); ++v)
    std::sort(sides.begin() + rows.begins()[v], sides.begin() + rows.begins()[v + 1],
              [&](const Side& s, const Side& other) { return key(s) < key(other); });
  return sides;
}

// Finds the edges. If more than two triangles meet in an edge, or two with opposite orientations,
// each triangle gets a border edge. Triangles without area have no edges, and their neighbors are
// marked unclear.
void set_edges(MeshTree& tree) {
  constexpr float kConvexSine = 1e-3f;
  const std::vector<Side> sides = sorted_sides(tree);
  const auto third = [&](const Side& s) {
    return corner_of(tree, static_cast<size_t>(s.triangle), static_cast<size_t>(s.corner) + 2);
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
    size_t full = i;  // end of the sides of triangles with area
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

// Builds the tree. The triangles are sorted once along each axis. Every node divides the three
// sorted lists, and the list by index, into two parts.
class Builder {
 public:
  explicit Builder(MeshTree& tree) : tree_(tree), is_left_(tree.triangles.size()) {
    const size_t count = tree.triangles.size();
    boxes_.reserve(count);
    for (const Vec3i& t : tree.triangles) {
      Box3 box{vertex(t.x), vertex(t.x)};
      for (const int32_t i : {t.y, t.z}) grow(box, {vertex(i), vertex(i)});
      boxes_.push_back(box);
    }
    tree_.order.resize(count);
    std::iota(tree_.order.begin(), tree_.order.end(), 0);
    for (int axis = 0; axis < 3; ++axis) along_[static_cast<size_t>(axis)] = sorted_along(axis);
    add(0, count);
  }

 private:
  const Vec3f& vertex(int32_t i) const { return tree_.vertices[static_cast<size_t>(i)]; }
  static void grow(Box3& box, const Box3& other) {
    box.lo = {std::min(box.lo.x, other.lo.x), std::min(box.lo.y, other.lo.y),
              std::min(box.lo.z, other.lo.z)};
    box.hi = {std::max(box.hi.x, other.hi.x), std::max(box.hi.y, other.hi.y),
              std::max(box.hi.z, other.hi.z)};
  }
  double center(int32_t triangle, int axis) const {
    const Box3& box = boxes_[static_cast<size_t>(triangle)];
    return (static_cast<double>(geometry::component(box.lo, axis)) +
            static_cast<double>(geometry::component(box.hi, axis))) *
           0.5;
  }
  // Returns the triangles sorted by their centers along an axis, and then by index. A radix sort on
  // float keys comes first. If keys are equal, the exact centers decide.
  std::vector<int32_t> sorted_along(int axis) const {
    struct Item {
      uint32_t key;
      int32_t triangle;
    };
    constexpr uint32_t kBits = 11, kDigits = 1u << kBits;
    std::vector<Item> items(boxes_.size()), other(boxes_.size());
    for (size_t t = 0; t < items.size(); ++t) {
      const auto triangle = static_cast<int32_t>(t);
      const auto bits = std::bit_cast<uint32_t>(static_cast<float>(center(triangle, axis)) + 0.0f);
      items[t] = {(bits >> 31) != 0 ? ~bits : bits | 0x80000000u, triangle};
    }
    for (uint32_t shift = 0; shift < 32; shift += kBits) {
      std::array<size_t, kDigits + 1> place{};
      for (const Item& item : items) ++place[(item.key >> shift) % kDigits + 1];
      std::partial_sum(place.begin(), place.end(), place.begin());
      for (const Item& item : items) other[place[(item.key >> shift) % kDigits]++] = item;
      items.swap(other);
    }
    const auto before = [&](const Item& a, const Item& b) {
      const double x = center(a.triangle, axis), y = center(b.triangle, axis);
      return x != y ? x < y : a.triangle < b.triangle;
    };
    for (size_t i = 0, end = 0; i < items.size(); i = end) {
      while (end < items.size() && items[end].key == items[i].key) ++end;
      const auto first = items.begin() + static_cast<std::ptrdiff_t>(i),
                 last = items.begin() + static_cast<std::ptrdiff_t>(end);
      if (!std::is_sorted(first, last, before)) std::sort(first, last, before);
    }
    std::vector<int32_t> along(items.size());
    for (size_t i = 0; i < items.size(); ++i) along[i] = items[i].triangle;
    return along;
  }
  size_t longest_axis(size_t begin, size_t end) const {
    size_t best = 0;
    double longest = -1.0;
    for (size_t axis = 0; axis < 3; ++axis) {
      const auto at = [&](size_t i) { return center(along_[axis][i], static_cast<int>(axis)); };
      const double length = at(end - 1) - at(begin);
      if (length > longest) {
        longest = length;
        best = axis;
      }
    }
    return best;
  }
  // Moves the items of the left half to the front. Both halves keep their order.
  void part(std::vector<int32_t>& list, size_t begin, size_t end) {
    size_t left = begin;
    right_.clear();
    for (size_t i = begin; i < end; ++i) {
      const int32_t t = list[i];
      if (is_left_[static_cast<size_t>(t)] != 0)
        list[left++] = t;
      else
        right_.push_back(t);
    }
    std::copy(right_.begin(), right_.end(), list.begin() + static_cast<std::ptrdiff_t>(left));
  }
  // Adds the node of order[begin .. end) and its subtree. The depth of the recursion is
  // logarithmic.
  void add(size_t begin, size_t end) {
    const size_t node = tree_.nodes.size();
    const bool leaf = end - begin <= kLeafTriangles;
    tree_.nodes.push_back({boxes_[static_cast<size_t>(tree_.order[begin])], 0,
                           static_cast<int32_t>(begin),
                           leaf ? static_cast<int32_t>(end - begin) : 0});
    Box3 box = tree_.nodes[node].box;
    if (leaf) {
      for (size_t i = begin; i < end; ++i) grow(box, boxes_[static_cast<size_t>(tree_.order[i])]);
    } else {
      const size_t axis = longest_axis(begin, end), middle = begin + (end - begin) / 2;
      for (size_t i = begin; i < end; ++i)
        is_left_[static_cast<size_t>(along_[axis][i])] = i < middle ? 1 : 0;
      for (size_t other = 0; other < 3; ++other)
        if (other != axis) part(along_[other], begin, end);
      part(tree_.order, begin, end);
      add(begin, middle);
      grow(box, tree_.nodes[node + 1].box);
      const size_t second = tree_.nodes.size();
      add(middle, end);
      grow(box, tree_.nodes[second].box);
    }
    tree_.nodes[node].box = box;
    tree_.nodes[node].skip = static_cast<int32_t>(tree_.nodes.size());
  }

  MeshTree& tree_;
  std::vector<Box3> boxes_;                    // boxes of the triangles
  std::array<std::vector<int32_t>, 3> along_;  // triangles sorted by center along each axis
  std::vector<uint8_t> is_left_;
  std::vector<int32_t> right_;
};

// Sets the box of the points in or behind the mesh. If the mesh has a border, the box extends
// behind the triangles by the size of the mesh.
void set_behind(MeshTree& tree) {
  Box3& box = tree.behind;
  box = tree.nodes[0].box;
  const float size = math::length(box.hi - box.lo);
  const auto has_border = [](const Vec3i& across) {
    constexpr int32_t kBorder = geometry::kMeshBorder;
    return across.x == kBorder || across.y == kBorder || across.z == kBorder;
  };
  if (std::none_of(tree.across.begin(), tree.across.end(), has_border)) return;
  Vec3f lo{}, hi{};  // bounds of the normals
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
  tree.triangles.reserve(indices.size() / 3);
  tree.normals.reserve(indices.size() / 3);
  const std::vector<int32_t> place = first_at_position(tree.vertices);
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
