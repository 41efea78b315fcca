// ShapePairList: the shape pairs (i < j) of a model that may touch, in lexicographic order. The
// list uses the bodies, flags, groups, worlds and filters at the time of finalize. The first use
// computes the list, because its length grows with the square of the number of shapes.
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
  // The inputs of the list, one row per shape: arrays of the model at the time of finalize.
  struct Columns {
    std::vector<int32_t> body, flags, collision_group, world;
  };
  static constexpr size_t kMostPairs = size_t{1} << 28;

  ShapePairList() = default;
  ShapePairList(const ShapePairList&) = delete;
  ShapePairList& operator=(const ShapePairList&) = delete;

  void follow(std::shared_ptr<const Columns> columns) { columns_ = std::move(columns); }
  const std::shared_ptr<const Columns>& columns() const { return columns_; }
  // Replaces the list. The columns are no longer used then.
  void set(DeviceArray<Vec2i> pairs);
  bool is_made() const { return made_.load(std::memory_order_acquire); }

  // Returns the list. Several threads may call this function. ErrorKind::Value: more than
  // kMostPairs pairs.
  const DeviceArray<Vec2i>& get(const std::set<std::pair<int32_t, int32_t>>& filter_pairs,
                                Device device) const;

 private:
  std::shared_ptr<const Columns> columns_;  // null: no shapes
  mutable std::mutex mutex_;
  mutable std::atomic<bool> made_{false};
  mutable DeviceArray<Vec2i> pairs_;
};

}  // namespace novaphy
