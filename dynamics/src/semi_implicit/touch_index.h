// TouchIndex: the touching contacts of a step by pair and by side, so that a step with many touches
// takes linear time.
#pragma once

#include <cstdint>
#include <span>
#include <unordered_map>
#include <vector>

#include "novaphy/core/sim/index_rows.h"
#include "touch_rows.h"

namespace novaphy::diff::detail {

// A pair of shapes, or a shape and a particle, as one number.
using PairKey = uint64_t;
template <class T>  // TouchRow or TouchEvent
PairKey pair_key(const T& of) {
  return uint64_t{static_cast<uint32_t>(of.first)} << 32 | static_cast<uint32_t>(of.second);
}

// The rows that push. Row indices are in ascending order.
class TouchIndex {
 public:
  TouchIndex(int32_t bodies, int32_t particles) : bodies_(bodies), particles_(particles) {}

  void build(std::span<const TouchRow> rows) {
    pair_indices_.clear();
    pairs_.clear();
    sides_.clear();
    for (const TouchRow& row : rows) {
      const auto next = static_cast<int32_t>(pair_indices_.size());
      pairs_.push_back(row.pushes ? pair_indices_.try_emplace(pair_key(row), next).first->second
                                  : -1);
      for (const TouchSide& side : row.sides) sides_.push_back(row.pushes ? number(side) : -1);
    }
    of_pair_.build(pairs_, static_cast<int32_t>(pair_indices_.size()));
    of_side_.build(sides_, bodies_ + particles_);
  }
  std::span<const int32_t> of_pair(PairKey key) const {
    const auto found = pair_indices_.find(key);
    if (found == pair_indices_.end()) return {};
    return of_pair_.items(found->second);
  }
  // Returns the rows of a side, as twice the row index plus the side's position (0 or 1) in the
  // row.
  std::span<const int32_t> of_side(const TouchSide& side) const {
    if (!side.exists()) return {};
    return of_side_.items(number(side));
  }

 private:
  int32_t number(const TouchSide& side) const {
    return side.particle >= 0 ? bodies_ + side.particle : side.body;
  }

  int32_t bodies_, particles_;
  std::unordered_map<PairKey, int32_t> pair_indices_;
  std::vector<int32_t> pairs_, sides_;
  IndexRows of_pair_, of_side_;
};

}  // namespace novaphy::diff::detail
