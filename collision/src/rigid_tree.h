// Internal: finds the pairs of shapes with overlapping boxes on a device, with a tree of boxes. The
// kernels are in rigid_tree_kernels.h.
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
  // Updates the tables. `world`: the world of each shape. ErrorKind::Index: a world that does not
  // exist.
  void update(const Model& model, std::span<const int32_t> world);
  // Launches kernels that sort the shapes (RigidShape), build the tree, and count the partners of
  // each shape. A partner is a shape whose box overlaps.
  void count(const Model& model, const Array& shapes);
  // Launches kernels that write as many pairs (shape0, shape1) as fit, in ascending order, and the
  // number of all pairs. Requires a call of count().
  void write(const Model& model, const Array& shapes, const DeviceArray<Vec2i>& pairs);
  const DeviceArray<int32_t>& found() const { return found_; }  // the number of all pairs

 private:
  void set_filters(const Model& model);
  void assign_slots(const Model& model, std::span<const int32_t> world);
  void set_levels(Device device);
  void sort(const Model& model, const Array& shapes);
  bool keeps_order();
  RigidTreeTables tables(const Model& model, const Array& shapes) const;

  // The recording with the last sort keeps this object alive, or this object does.
  std::weak_ptr<ExclusiveUse> sorted_in_;
  std::shared_ptr<ExclusiveUse> sorted_at_once_;
  int32_t searches_ = 0;  // searches since the last sort
  int64_t segments_ = 0, entry_count_ = 0, slot_count_ = 0;
  std::vector<int64_t> level_counts_;  // number of nodes of each level
  std::vector<int32_t> levels_;        // first node of each level
  // Tables of the shapes, and of the threads that search for partners.
  DeviceArray<int32_t> filter_starts_, filtered_, slots_, apart_, members_, starts_, level_starts_;
  DeviceArray<int32_t> keys_, order_, counts_, before_, found_;
  DeviceArray<Vec2i> kept_;
  DeviceArray<uint64_t> totals_;
  Array bounds_, entries_, nodes_;  // rows of structs, stored as bytes
};

// The source code of the device kernels. Null: the build has no device kernels.
const char* rigid_tree_kernels_source();

}  // namespace novaphy::detail
