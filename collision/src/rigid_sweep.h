// Internal: the pairs of shapes whose boxes meet, found by sweep and prune on their device. The
// kernels are those of rigid_sweep_kernels.h.
#pragma once

#include <cstdint>
#include <memory>
#include <set>
#include <span>
#include <utility>

#include "novaphy/core/device_array.h"
#include "novaphy/core/sim/model.h"

namespace novaphy::detail {

class RigidSweep {
 public:
  // Tables of a model whose shapes have these worlds. `left_out`: pairs that do not meet, besides
  // those of the model. ErrorKind::Index: a world that is not there.
  void update(const Model& model, std::span<const int32_t> world,
              const std::set<std::pair<int32_t, int32_t>>& left_out);
  // Launches that sort the shapes (RigidShape) and count the partners of each.
  void sort(const Model& model, const Array& shapes);
  // Behind `sort`: launches that write the pairs (shape0, shape1), in ascending order, as many as
  // there is room for, and their true number.
  void write(const Model& model, const Array& shapes, const DeviceArray<Vec2i>& pairs);
  const DeviceArray<int32_t>& found() const { return found_; }  // that number

 private:
  int64_t axis_ = 0, segments_ = 0;
  DeviceArray<int32_t> filter_starts_, filtered_;
  DeviceArray<int32_t> keys_, order_, world_keys_, starts_, items_, counts_, before_, found_;
  DeviceArray<uint64_t> totals_;
  std::shared_ptr<Storage> entries_, chunks_, coarse_;
};

// The text of the kernels for devices; null: the build has none.
const char* rigid_sweep_kernels_text();

}  // namespace novaphy::detail
