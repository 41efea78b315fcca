#include "box_index.h"

#include <algorithm>
#include <cmath>

#include "sweep_axis.h"

namespace novaphy::detail {
namespace {

constexpr float kLong = 8.0f;  // times the mean length: longer boxes get a separate list

}  // namespace

void BoxIndex::build(std::span<const int32_t> members, std::span<const RigidShape> shapes,
                     std::span<const int32_t> world) {
  entries_.clear();
  apart_.clear();
  segments_.clear();
  for (const int32_t s : members) {
    const geometry::Box3& box = shapes[static_cast<size_t>(s)].box;
    const Vec3f size = box.hi - box.lo;
    const bool is_finite = std::isfinite(size.x + size.y + size.z);
    if (!geometry::boxes_meet(box, box)) continue;
    (is_finite ? entries_ : apart_).push_back({0.0f, s, box});
  }
  double length = 0.0;
  const auto longest_side = [](const geometry::Box3& box) {
    const Vec3f size = box.hi - box.lo;
    return std::max({size.x, size.y, size.z});
  };
  // Two passes, because very long boxes such as a ground make the first mean too large.
  for (int pass = 0; pass < 2; ++pass) {
    length = 0.0;
    for (const Entry& one : entries_) length += static_cast<double>(longest_side(one.box));
    const auto most =
        static_cast<float>(length / static_cast<double>(std::max<size_t>(entries_.size(), 1))) *
        kLong;
    const auto rest =
        std::stable_partition(entries_.begin(), entries_.end(),
                              [&](const Entry& one) { return longest_side(one.box) <= most; });
    apart_.insert(apart_.end(), rest, entries_.end());
    entries_.erase(rest, entries_.end());
  }
  axis_ = sweep_axis(entries_, [](const Entry& one) -> const geometry::Box3& { return one.box; });
  longest_ = 0.0f;
  for (Entry& one : entries_) {
    one.begin = along(one.box.lo);
    longest_ = std::max(longest_, along(one.box.hi) - one.begin);
  }
  // Rounding of the ends may shorten a box by the added length.
  float farthest = 0.0f;
  for (const Entry& one : entries_) farthest = std::max(farthest, std::abs(one.begin));
  longest_ += 1.0e-6f * (farthest + longest_);
  const auto world_of = [&](const Entry& one) {
    return std::max(world[static_cast<size_t>(one.shape)], -1);
  };
  std::sort(entries_.begin(), entries_.end(), [&](const Entry& a, const Entry& b) {
    const int32_t x = world_of(a), y = world_of(b);
    if (x != y) return x < y;
    return a.begin != b.begin ? a.begin < b.begin : a.shape < b.shape;
  });
  for (size_t k = 0; k < entries_.size(); ++k) {
    if (k == 0 || world_of(entries_[k]) != segments_.back().world)
      segments_.push_back({world_of(entries_[k]), k, k});
    segments_.back().end = k + 1;
  }
}

size_t BoxIndex::first_behind(const Segment& segment, float begin) const {
  const auto first = entries_.begin() + static_cast<std::ptrdiff_t>(segment.begin);
  const auto last = entries_.begin() + static_cast<std::ptrdiff_t>(segment.end);
  return static_cast<size_t>(
      std::lower_bound(first, last, begin,
                       [](const Entry& one, float x) { return one.begin < x; }) -
      entries_.begin());
}

}  // namespace novaphy::detail
