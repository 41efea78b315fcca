// A tree of boxes, for many small boxes that move. The tree is split once, at the median of the
// boxes' positions. Later calls only recompute the boxes of the nodes. The tree stays efficient if
// neighboring boxes stay neighbors.
#pragma once

#include <algorithm>
#include <cstdint>
#include <numeric>
#include <span>
#include <tuple>
#include <vector>

#include "novaphy/collision/geometry/mesh_view.h"

namespace novaphy::detail {

inline geometry::Box3 united(const geometry::Box3& a, const geometry::Box3& b) {
  return {{std::min(a.lo.x, b.lo.x), std::min(a.lo.y, b.lo.y), std::min(a.lo.z, b.lo.z)},
          {std::max(a.hi.x, b.hi.x), std::max(a.hi.y, b.hi.y), std::max(a.hi.z, b.hi.z)}};
}

class BoxTree {
 public:
  // `positions`: a point of each box. `worlds`: the world of each box; -1: all worlds.
  void build(std::span<const Vec3f> positions, std::span<const int32_t> worlds) {
    nodes_.clear();
    std::vector<int32_t> items(positions.size());
    std::iota(items.begin(), items.end(), 0);
    if (!items.empty()) split(positions, worlds, items);
  }
  void fit(std::span<const geometry::Box3> boxes) {
    for (size_t k = nodes_.size(); k-- > 0;) {
      Node& node = nodes_[k];
      node.box = node.item >= 0 ? boxes[static_cast<size_t>(node.item)]
                                : united(nodes_[k + 1].box, nodes_[nodes_[k + 1].end].box);
    }
  }
  // Calls body(index) for each box of a compatible world that overlaps `box` and has at least the
  // index `first`. The order of the calls is not defined.
  template <class Body>
  void visit(const geometry::Box3& box, int32_t world, int32_t first, const Body& body) const {
    for (size_t k = 0; k < nodes_.size();) {
      const Node& node = nodes_[k];
      const bool is_apart = world >= 0 && node.world >= 0 && node.world != world;
      if (is_apart || node.last < first || !geometry::boxes_meet(box, node.box)) {
        k = node.end;
        continue;
      }
      if (node.item >= 0) body(node.item);
      ++k;
    }
  }

 private:
  struct Node {
    geometry::Box3 box{};
    int32_t world = -1;  // of all boxes in the subtree; -1: several
    int32_t last = 0;    // largest index in the subtree
    int32_t item = -1;   // of a leaf
    size_t end = 0;      // first node after the subtree
  };

  // Adds a node for the given items, and its subtree.
  void split(std::span<const Vec3f> positions, std::span<const int32_t> worlds,
             std::span<int32_t> items) {
    const auto world_of = [&](int32_t i) { return worlds[static_cast<size_t>(i)]; };
    const auto position_of = [&](int32_t i) { return positions[static_cast<size_t>(i)]; };
    const size_t number = nodes_.size();
    geometry::Box3 around = {position_of(items[0]), position_of(items[0])};
    Node node = {.world = world_of(items[0])};
    for (const int32_t i : items) {
      around = united(around, {position_of(i), position_of(i)});
      node.last = std::max(node.last, i);
      if (world_of(i) != node.world) node.world = -1;
    }
    nodes_.push_back(node);
    if (items.size() == 1) {
      nodes_[number].item = items[0];
    } else {
      const Vec3f size = around.hi - around.lo;
      const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
      const auto key = [&](int32_t i) {
        return std::tuple(world_of(i), geometry::component(position_of(i), axis), i);
      };
      const size_t middle = items.size() / 2;
      std::nth_element(items.begin(), items.begin() + static_cast<std::ptrdiff_t>(middle),
                       items.end(), [&](int32_t a, int32_t b) { return key(a) < key(b); });
      split(positions, worlds, items.first(middle));
      split(positions, worlds, items.subspan(middle));
    }
    nodes_[number].end = nodes_.size();
  }

  std::vector<Node> nodes_;  // a node comes before its descendants
};

}  // namespace novaphy::detail
