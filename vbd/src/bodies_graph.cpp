// Colors and trees of the bodies of a step of VBD.
#include <algorithm>
#include <numeric>

#include "bodies.h"

namespace novaphy::vbd {

void BodyLists::build(int32_t count, std::span<const std::pair<int32_t, int32_t>> pairs) {
  keys_.clear();
  for (const auto& [key, number] : pairs) keys_.push_back(key);
  places_.build(keys_, count);
  begin.assign(places_.begins().begin(), places_.begins().end());
  items.clear();
  for (const int32_t place : places_.all())
    items.push_back(pairs[static_cast<size_t>(place)].second);
}

void BodyGraph::find_neighbors(int32_t bodies, std::span<const std::array<int32_t, 2>> pairs) {
  pairs_.clear();
  for (const auto& [a, b] : pairs) {
    if (a < 0 || b < 0) continue;
    pairs_.emplace_back(a, b);
    pairs_.emplace_back(b, a);
  }
  std::sort(pairs_.begin(), pairs_.end());
  pairs_.erase(std::unique(pairs_.begin(), pairs_.end()), pairs_.end());
  neighbors_.build(bodies, pairs_);
}

int32_t BodyGraph::root_of(int32_t body) {
  while (root_[index(body)] != body) body = root_[index(body)] = root_[index(root_[index(body)])];
  return body;
}

// Finds a spanning forest. Its edges are the rows that close no cycle with earlier rows. The root
// of a tree is its body with the lowest index.
void BodyGraph::find_trees(int32_t bodies, std::span<const std::array<int32_t, 2>> pairs) {
  root_.resize(index(bodies));
  std::iota(root_.begin(), root_.end(), 0);
  pairs_.clear();
  for (const auto& [a, b] : pairs) {
    if (a < 0 || b < 0 || root_of(a) == root_of(b)) continue;
    root_[index(root_of(a))] = root_of(b);
    pairs_.emplace_back(a, b);
    pairs_.emplace_back(b, a);
  }
  tree_neighbors_.build(bodies, pairs_);
  nodes.clear();
  node_parent.clear();
  tree_first.assign(1, 0);
  parent_.assign(index(bodies), -1);
  node_of_.assign(index(bodies), -1);
  for (int32_t body = 0; body < bodies; ++body) {
    if (node_of_[index(body)] >= 0 || rows.of(body).empty()) continue;
    const auto add = [this](int32_t of, int32_t parent_node) {
      node_of_[index(of)] = static_cast<int32_t>(nodes.size());
      nodes.push_back(of);
      node_parent.push_back(parent_node);
    };
    add(body, -1);
    for (size_t at = index(tree_first.back()); at < nodes.size(); ++at)
      for (const int32_t next : tree_neighbors_.of(nodes[at])) {
        if (node_of_[index(next)] >= 0) continue;
        parent_[index(next)] = nodes[at];
        add(next, static_cast<int32_t>(at));
      }
    tree_first.push_back(static_cast<int32_t>(nodes.size()));
  }
}

// Colors the bodies of trees whose rows close cycles. The coloring is greedy, and starts with the
// bodies that have the most neighbors.
void BodyGraph::find_colors(int32_t bodies, std::span<const std::array<int32_t, 2>> pairs) {
  has_cycles_.assign(index(bodies), 0);
  for (const auto& pair : pairs)
    if (is_outside(pair)) has_cycles_[index(root_of(pair[0]))] = 1;
  order_.resize(index(bodies));
  std::iota(order_.begin(), order_.end(), 0);
  std::stable_sort(order_.begin(), order_.end(), [this](int32_t a, int32_t b) {
    return neighbors_.of(a).size() > neighbors_.of(b).size();
  });
  color_.assign(index(bodies), -1);
  int32_t count = 0;
  for (const int32_t body : order_) {
    int32_t color = 0;
    const auto is_taken = [&] {
      const auto near = neighbors_.of(body);
      return std::any_of(near.begin(), near.end(),
                         [&](int32_t other) { return color_[index(other)] == color; });
    };
    while (is_taken()) ++color;
    color_[index(body)] = color;
    count = std::max(count, color + 1);
  }
  pairs_.clear();
  for (int32_t body = 0; body < bodies; ++body)
    if (has_cycles_[index(root_of(body))] != 0) pairs_.emplace_back(color_[index(body)], body);
  colors.build(count, pairs_);
}

void BodyGraph::build(int32_t bodies, std::span<const std::array<int32_t, 2>> pairs,
                      std::span<const int32_t> numbers, size_t acting) {
  pairs_.clear();
  for (size_t k = 0; k < pairs.size(); ++k)
    for (int32_t side = 0; side < 2; ++side)
      if (const int32_t body = pairs[k][index(side)]; body >= 0)
        pairs_.emplace_back(body, numbers[k] + side);
  rows.build(bodies, pairs_);
  find_trees(bodies, pairs);
  find_neighbors(bodies, pairs);
  find_colors(bodies, pairs.first(acting));
}

}  // namespace novaphy::vbd
