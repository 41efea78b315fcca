// Internal: the pairs of shapes whose boxes meet, found on their device by a tree of boxes. The
// kernels are those of rigid_tree_kernels.h.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "novaphy/core/device_array.h"
#include "novaphy/core/exclusive_use.h"
#include "novaphy/core/sim/model.h"

namespace novaphy {
struct RigidTreeTables;
}

namespace novaphy::detail {

class RigidTree {
 public:
  // Tables of a model whose shapes have these worlds. ErrorKind::Index: a world that is not there.
  void update(const Model& model, std::span<const int32_t> world);
  // Launches that sort the shapes (RigidShape), make the tree and count the partners of each.
  void count(const Model& model, const Array& shapes);
  // Behind `count`: launches that write the pairs (shape0, shape1), in ascending order, as many as
  // there is room for, and their true number.
  void write(const Model& model, const Array& shapes, const DeviceArray<Vec2i>& pairs);
  const DeviceArray<int32_t>& found() const { return found_; }  // that number

 private:
  void set_filters(const Model& model);
  void set_places(const Model& model, std::span<const int32_t> world);
  void set_levels(Device device);
  void sort(const Model& model, const Array& shapes);
  bool keeps_order();
  RigidTreeTables tables(const Model& model, const Array& shapes) const;

  // Held by the recording that the last sort is part of, or by this.
  std::weak_ptr<ExclusiveUse> sorted_in_;
  std::shared_ptr<ExclusiveUse> sorted_at_once_;
  int32_t searches_ = 0;  // since then
  int64_t segments_ = 0, entry_count_ = 0, slot_count_ = 0;
  std::vector<int64_t> level_counts_;  // nodes of each level
  std::vector<int32_t> levels_;        // the first of them
  // Of the shapes, and where pairs are asked for.
  DeviceArray<int32_t> filter_starts_, filtered_, slots_, apart_, members_, starts_, level_starts_;
  DeviceArray<int32_t> keys_, order_, counts_, before_, found_;
  DeviceArray<Vec2i> kept_;
  DeviceArray<uint64_t> totals_;
  Array bounds_, entries_, nodes_;  // bytes
};

// The text of the kernels for devices; null: the build has none.
const char* rigid_tree_kernels_source();

}  // namespace novaphy::detail
