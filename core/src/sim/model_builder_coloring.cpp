// Coloring of the particles of a ModelBuilder.
#include <algorithm>
#include <numeric>
#include <queue>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"

namespace novaphy {
namespace {

// For each particle, the particles that share an element with it.
struct Neighbors {
  std::vector<size_t> begin;  // particles + 1 offsets into items
  std::vector<int32_t> items;

  Neighbors(size_t particles, std::vector<std::pair<int32_t, int32_t>> pairs)
      : begin(particles + 1) {
    std::sort(pairs.begin(), pairs.end());
    pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
    for (const auto& [p, q] : pairs) {
      ++begin[static_cast<size_t>(p) + 1];
      items.push_back(q);
    }
    std::partial_sum(begin.begin(), begin.end(), begin.begin());
  }
  std::span<const int32_t> of(size_t p) const {
    return std::span(items).subspan(begin[p], begin[p + 1] - begin[p]);
  }
};

// Returns the order in which the greedy coloring visits the particles (smallest last). Each
// particle has the fewest neighbors among itself and the particles before it. On a tie the largest
// index comes last.
std::vector<int32_t> smallest_last_order(const Neighbors& neighbors) {
  const size_t count = neighbors.begin.size() - 1;
  using Entry = std::pair<size_t, int32_t>;  // degree and negative index
  std::priority_queue<Entry, std::vector<Entry>, std::greater<>> queue;
  std::vector<size_t> degree(count);
  for (size_t p = 0; p < count; ++p) {
    degree[p] = neighbors.of(p).size();
    queue.push({degree[p], -static_cast<int32_t>(p)});
  }
  std::vector<bool> removed(count);
  std::vector<int32_t> order(count);
  for (size_t place = count; place > 0;) {
    const auto [d, minus_p] = queue.top();
    queue.pop();
    const auto p = static_cast<size_t>(-minus_p);
    if (removed[p] || d != degree[p]) continue;  // an outdated entry: the degree has dropped since
    removed[p] = true;
    order[--place] = static_cast<int32_t>(p);
    for (const int32_t q : neighbors.of(p))
      if (!removed[static_cast<size_t>(q)]) queue.push({--degree[static_cast<size_t>(q)], -q});
  }
  return order;
}

bool may_have(const Neighbors& neighbors, const std::vector<int32_t>& colors, size_t p,
              int32_t color) {
  return std::ranges::none_of(neighbors.of(p),
                              [&](int32_t q) { return colors[static_cast<size_t>(q)] == color; });
}

// Balances the colors. Particles move, in the order of their indices, from colors above the mean
// size to the smallest color without a neighbor, until no particle moves.
void balance(const Neighbors& neighbors, std::vector<int32_t>& colors, size_t color_count) {
  std::vector<size_t> size(color_count);
  for (const int32_t color : colors) ++size[static_cast<size_t>(color)];
  const size_t small = colors.size() / color_count;
  for (bool moved = true; moved;) {
    moved = false;
    for (size_t p = 0; p < colors.size(); ++p) {
      if (size[static_cast<size_t>(colors[p])] <= small + 1) continue;
      size_t best = color_count;
      for (size_t color = 0; color < color_count; ++color) {
        if (size[color] < small && (best == color_count || size[color] < size[best]) &&
            may_have(neighbors, colors, p, static_cast<int32_t>(color)))
          best = color;
      }
      if (best == color_count) continue;
      --size[static_cast<size_t>(colors[p])];
      ++size[best];
      colors[p] = static_cast<int32_t>(best);
      moved = true;
    }
  }
}

}  // namespace

template <class Visit>
void ModelBuilder::visit_colored_elements(bool bending, Visit&& visit) const {
  const auto acts = [](const std::vector<float>& material, size_t element, size_t width,
                       size_t columns) {
    const auto first = material.begin() + static_cast<std::ptrdiff_t>(element * width);
    return std::any_of(first, first + static_cast<std::ptrdiff_t>(columns),
                       [](float value) { return value != 0.0f; });
  };
  for (size_t e = 0; e < springs_.indices.size(); ++e) {
    const auto [i, j] = springs_.indices[e];
    if (springs_.stiffness[e] != 0.0f || springs_.damping[e] != 0.0f)
      visit("spring", e, std::initializer_list<int32_t>{i, j});
  }
  for (size_t e = 0; e < triangles_.indices.size(); ++e) {
    const auto [i, j, k] = triangles_.indices[e];
    if (acts(triangles_.material, e, 5, 3))
      visit("triangle", e, std::initializer_list<int32_t>{i, j, k});
  }
  for (size_t e = 0; e < tetrahedra_.indices.size(); ++e) {
    const auto [i, j, k, l] = tetrahedra_.indices[e];
    if (acts(tetrahedra_.material, e, 3, 3))
      visit("tetrahedron", e, std::initializer_list<int32_t>{i, j, k, l});
  }
  if (!bending) return;
  for (size_t e = 0; e < edges_.indices.size(); ++e) {
    const auto [i, j, k, l] = edges_.indices[e];
    if (i >= 0 && j >= 0 && acts(edges_.material, e, 2, 2))
      visit("bending edge", e, std::initializer_list<int32_t>{i, j, k, l});
  }
}

void ModelBuilder::color(const ColorArgs& args) {
  check_sizes();
  const size_t count = particle_q.size();
  const bool bending = args.include_bending.value_or(true);
  std::vector<std::pair<int32_t, int32_t>> pairs;
  visit_colored_elements(bending,
                         [&](std::string_view, size_t, std::initializer_list<int32_t> corners) {
                           for (const int32_t p : corners)
                             for (const int32_t q : corners)
                               if (p != q) pairs.push_back({p, q});
                         });
  const Neighbors neighbors(count, std::move(pairs));

  std::vector<int32_t> colors(count, -1);
  std::vector<bool> taken;
  for (const int32_t p : smallest_last_order(neighbors)) {
    taken.assign(taken.size(), false);
    for (const int32_t q : neighbors.of(static_cast<size_t>(p)))
      if (colors[static_cast<size_t>(q)] >= 0)
        taken[static_cast<size_t>(colors[static_cast<size_t>(q)])] = true;
    const auto free =
        static_cast<size_t>(std::find(taken.begin(), taken.end(), false) - taken.begin());
    if (free == taken.size()) taken.push_back(false);
    colors[static_cast<size_t>(p)] = static_cast<int32_t>(free);
  }
  if (args.balance_colors && count > 0) balance(neighbors, colors, taken.size());
  colors_ = std::move(colors);
  color_check_ = bending ? ColorCheck::All : ColorCheck::WithoutBending;
}

void ModelBuilder::set_coloring(std::span<const std::vector<int32_t>> groups,
                                bool allow_conflicts) {
  constexpr std::string_view name = "set_coloring";
  std::vector<int32_t> colors(particle_q.size(), -1);
  for (size_t color = 0; color < groups.size(); ++color) {
    require(!groups[color].empty(), ErrorKind::Value, name, ": groups[", color,
            "]: expected particles, got none");
    for (const int32_t p : groups[color]) {
      require(p >= 0 && p < particle_count(), ErrorKind::Index, name, ": groups[", color,
              "]: expected particles from 0 to ", particle_count() - 1, ", got ", p);
      int32_t& own = colors[static_cast<size_t>(p)];
      require(own < 0, ErrorKind::Value, name,
              ": groups: expected every particle once, got particle ", p, " in groups ", own,
              " and ", color);
      own = static_cast<int32_t>(color);
    }
  }
  const auto missing = std::find(colors.begin(), colors.end(), -1);
  require(missing == colors.end(), ErrorKind::Value, name,
          ": groups: expected every particle once, got none with particle ",
          missing - colors.begin());
  std::swap(colors_, colors);
  const ColorCheck before = color_check_;
  color_check_ = allow_conflicts ? ColorCheck::None : ColorCheck::All;
  try {
    check_coloring(name);
  } catch (...) {
    colors_ = std::move(colors);
    color_check_ = before;
    throw;
  }
}

void ModelBuilder::check_coloring(std::string_view function) const {
  if (colors_.empty() || color_check_ == ColorCheck::None) return;
  visit_colored_elements(
      color_check_ == ColorCheck::All,
      [&](std::string_view kind, size_t e, std::initializer_list<int32_t> corners) {
        for (const int32_t* p = corners.begin(); p != corners.end(); ++p) {
          if (static_cast<size_t>(*p) >= colors_.size()) continue;
          const int32_t color = colors_[static_cast<size_t>(*p)];
          for (const int32_t* q = corners.begin(); q != p; ++q) {
            const bool same = *q != *p && static_cast<size_t>(*q) < colors_.size() &&
                              colors_[static_cast<size_t>(*q)] == color && color >= 0;
            require(!same, ErrorKind::Value, function, ": ", kind, " ", e,
                    ": expected particles of different colors, got particles ", *q, " and ", *p,
                    " of color ", color,
                    "; call color() after the elements are added, or set_coloring with "
                    "allow_conflicts");
          }
        }
      });
}

}  // namespace novaphy
