#include "novaphy/collision/box_pairs.h"

#include <algorithm>
#include <iterator>
#include <numeric>

#include "novaphy/core/error.h"
#include "sweep_axis.h"

namespace novaphy {
namespace {

using geometry::Box3;

// Returns the pairs that `visit_all` reports, sorted by their smaller shape and then by the larger
// one.
template <class VisitAll>
std::vector<Vec2i> sorted_pairs(const char* function, size_t shapes, int64_t limit,
                                VisitAll visit_all) {
  std::vector<Vec2i> found;
  std::vector<int64_t> start(shapes + 1, 0);
  int64_t count = 0;
  visit_all([&](int32_t i, int32_t j) {
    if (++count <= limit) found.push_back({i, j});
    ++start[static_cast<size_t>(i) + 1];
  });
  require(count <= limit, ErrorKind::Value, function, ": limit: expected at most ", limit,
          " pairs, got ", count);
  std::partial_sum(start.begin(), start.end(), start.begin());
  std::vector<Vec2i> pairs(found.size());
  std::vector<int64_t> next(start.begin(), start.end() - 1);
  for (const Vec2i& pair : found)
    pairs[static_cast<size_t>(next[static_cast<size_t>(pair.x)]++)] = pair;
  for (size_t i = 0; i < shapes; ++i)
    std::sort(pairs.begin() + start[i], pairs.begin() + start[i + 1],
              [](const Vec2i& a, const Vec2i& b) { return a.y < b.y; });
  return pairs;
}

void check_boxes(const char* function, std::span<const Box3> boxes, const ShapePairRules& rules) {
  check_rules(function, rules);
  require(boxes.size() == rules.body.size(), ErrorKind::Value, function,
          ": boxes: expected one per shape (", rules.body.size(), "), got ", boxes.size());
}

bool meets_itself(const Box3& box) { return boxes_meet(box, box); }  // false for NaN or lo > hi

// Insertion sort for a nearly sorted list. If more than a few moves per item are needed, std::sort
// takes over. The order is total, so that both sorts give the same result.
template <class Before>
void sort_again(std::vector<int32_t>& order, Before before) {
  size_t moves = 8 * order.size();
  for (size_t i = 1; i < order.size(); ++i) {
    const int32_t item = order[i];
    size_t k = i;
    for (; k > 0 && before(item, order[k - 1]); --k) {
      order[k] = order[k - 1];
      if (--moves == 0) {
        order[k - 1] = item;
        std::sort(order.begin(), order.end(), before);
        return;
      }
    }
    order[k] = item;
  }
}

}  // namespace

std::vector<Vec2i> explicit_box_pairs(std::span<const Box3> boxes,
                                      std::span<const Vec2i> candidates, int64_t limit) {
  const auto count = static_cast<int32_t>(boxes.size());
  for (size_t k = 0; k < candidates.size(); ++k) {
    const Vec2i& c = candidates[k];
    require(c.x >= 0 && c.x < c.y && c.y < count, ErrorKind::Value,
            "explicit_box_pairs: candidates[", k, "]: expected 0 <= i < j < ", count, ", got (",
            c.x, ", ", c.y, ")");
  }
  return sorted_pairs("explicit_box_pairs", boxes.size(), limit, [&](auto visit) {
    for (const Vec2i& c : candidates)
      if (boxes_meet(boxes[static_cast<size_t>(c.x)], boxes[static_cast<size_t>(c.y)]))
        visit(c.x, c.y);
  });
}

std::vector<Vec2i> nxn_box_pairs(std::span<const Box3> boxes, const ShapePairRules& rules,
                                 int64_t limit) {
  check_boxes("nxn_box_pairs", boxes, rules);
  const auto count = static_cast<int32_t>(boxes.size());
  return sorted_pairs("nxn_box_pairs", boxes.size(), limit, [&](auto visit) {
    for (int32_t i = 0; i < count; ++i)
      for (int32_t j = i + 1; j < count; ++j)
        if (boxes_meet(boxes[static_cast<size_t>(i)], boxes[static_cast<size_t>(j)]) &&
            may_touch(rules, i, j))
          visit(i, j);
  });
}

std::vector<Vec2i> SweepAndPrune::box_pairs(std::span<const Box3> boxes,
                                            const ShapePairRules& rules, int64_t limit) {
  check_boxes("SweepAndPrune.box_pairs", boxes, rules);
  const size_t count = boxes.size();
  if (order_.size() != count) {
    order_.resize(count);
    std::iota(order_.begin(), order_.end(), 0);
  }
  const int axis = detail::sweep_axis(boxes, [](const Box3& box) -> const Box3& { return box; });
  auto box = [&](int32_t i) -> const Box3& { return boxes[static_cast<size_t>(i)]; };
  auto lower = [&](int32_t i) {  // boxes that overlap no box come last
    return meets_itself(box(i)) ? geometry::component(box(i).lo, axis)
                                : std::numeric_limits<float>::infinity();
  };
  sort_again(order_, [&](int32_t a, int32_t b) {
    const float x = lower(a), y = lower(b);
    return x != y ? x < y : a < b;
  });

  // The sorted shapes of each world, and of all worlds (-1).
  std::vector<int32_t> worlds(rules.world.begin(), rules.world.end());
  for (int32_t& w : worlds) w = std::max(w, -1);
  std::vector<int32_t> by_world;
  for (const int32_t i : order_)
    if (meets_itself(box(i))) by_world.push_back(i);
  const auto world_before = [&](int32_t a, int32_t b) {
    return worlds[static_cast<size_t>(a)] < worlds[static_cast<size_t>(b)];
  };
  if (!std::is_sorted(by_world.begin(), by_world.end(), world_before))
    std::stable_sort(by_world.begin(), by_world.end(), world_before);
  const auto in_world = [&](int32_t i) { return worlds[static_cast<size_t>(i)]; };
  const auto own_begin =
      std::find_if(by_world.begin(), by_world.end(), [&](int32_t i) { return in_world(i) >= 0; });
  const std::vector<int32_t> shared(by_world.begin(), own_begin);

  // Boxes in the order of the sweep, stored side by side.
  struct Swept {
    float begin, end;    // ends along the axis
    float lo[2], hi[2];  // ends along the other two axes
    int32_t shape;
  };
  std::vector<Swept> swept;
  const int others[2] = {(axis + 1) % 3, (axis + 2) % 3};
  const auto sweep = [&](const std::vector<int32_t>& sorted, bool with_shared_pairs, auto visit) {
    swept.clear();
    for (const int32_t i : sorted) {
      const Vec3f &lo = box(i).lo, &hi = box(i).hi;
      using geometry::component;
      swept.push_back({component(lo, axis),
                       component(hi, axis),
                       {component(lo, others[0]), component(lo, others[1])},
                       {component(hi, others[0]), component(hi, others[1])},
                       i});
    }
    for (size_t k = 0; k < swept.size(); ++k) {
      const Swept a = swept[k];
      for (size_t m = k + 1; m < swept.size() && swept[m].begin <= a.end; ++m) {
        const Swept& b = swept[m];
        const bool apart =
            a.lo[0] > b.hi[0] || b.lo[0] > a.hi[0] || a.lo[1] > b.hi[1] || b.lo[1] > a.hi[1];
        if (apart) continue;
        const int32_t i = a.shape, j = b.shape;
        if (!with_shared_pairs && in_world(i) < 0 && in_world(j) < 0) continue;
        if (may_touch(rules, i, j)) visit(std::min(i, j), std::max(i, j));
      }
    }
  };
  return sorted_pairs("SweepAndPrune.box_pairs", count, limit, [&](auto visit) {
    sweep(shared, true, visit);
    std::vector<int32_t> together;
    for (auto begin = own_begin; begin != by_world.end();) {
      const int32_t world = in_world(*begin);
      const auto end =
          std::find_if(begin, by_world.end(), [&](int32_t i) { return in_world(i) != world; });
      together.clear();
      std::merge(begin, end, shared.begin(), shared.end(), std::back_inserter(together),
                 [&](int32_t a, int32_t b) {
                   const float x = lower(a), y = lower(b);
                   return x != y ? x < y : a < b;
                 });
      sweep(together, false, visit);
      begin = end;
    }
  });
}

}  // namespace novaphy
