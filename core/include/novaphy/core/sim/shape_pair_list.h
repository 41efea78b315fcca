// The shape pairs (i < j) of a model that may touch, in lexicographic order. Bodies, flags, groups,
// worlds and filters of the shapes count as they were when the model was made. The first use lists
// the pairs, because their number is the square of the number of shapes.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <set>
#include <utility>
#include <vector>

#include "novaphy/core/device_array.h"

namespace novaphy {

class NOVAPHY_CORE_API ShapePairList {
 public:
  // What the pairs follow from, a row per shape: the arrays of the model when it was made.
  struct Columns {
    std::vector<int32_t> body, flags, collision_group, world;
  };
  static constexpr size_t kMostPairs = size_t{1} << 28;

  ShapePairList() = default;
  ShapePairList(const ShapePairList&) = delete;
  ShapePairList& operator=(const ShapePairList&) = delete;

  void follow(std::shared_ptr<const Columns> columns) { columns_ = std::move(columns); }
  const std::shared_ptr<const Columns>& columns() const { return columns_; }
  // The list from now on, whatever the columns say.
  void set(DeviceArray<Vec2i> pairs);
  bool is_made() const { return made_.load(std::memory_order_acquire); }

  // Several threads may call it. ErrorKind::Value: more than kMostPairs.
  const DeviceArray<Vec2i>& get(const std::set<std::pair<int32_t, int32_t>>& filter_pairs,
                                Device device) const;

 private:
  std::shared_ptr<const Columns> columns_;  // null: no shapes
  mutable std::mutex mutex_;
  mutable std::atomic<bool> made_{false};
  mutable DeviceArray<Vec2i> pairs_;
};

}  // namespace novaphy
