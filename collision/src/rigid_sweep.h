// Internal: the pairs of shapes whose boxes meet, found by sweep and prune on their device. The
// kernels are those of rigid_sweep_kernels.h.
#pragma once

#include <cstdint>
#include <memory>
#include <span>

#include "novaphy/core/device_array.h"
#include "novaphy/core/sim/model.h"

namespace novaphy {
struct RigidSweepTables;
}

namespace novaphy::detail {

class RigidSweep {
 public:
  // Tables of a model whose shapes have these worlds. ErrorKind::Index: a world that is not there.
  void update(const Model& model, std::span<const int32_t> world);
  // Launches that sort the shapes (RigidShape) and count the partners of each.
  void sort(const Model& model, const Array& shapes);
  // Behind `sort`: launches that write the pairs (shape0, shape1), in ascending order, as many as
  // there is room for, and their true number.
  void write(const Model& model, const Array& shapes, const DeviceArray<Vec2i>& pairs);
  const DeviceArray<int32_t>& found() const { return found_; }  // that number

 private:
  RigidSweepTables tables(const Model& model, const Array& shapes) const;

  int64_t axis_ = 0, segments_ = 0;
  DeviceArray<int32_t> filter_starts_, filtered_;
  DeviceArray<int32_t> keys_, order_, world_keys_, starts_, items_, counts_, before_, found_;
  DeviceArray<uint64_t> totals_;
  Array entries_, chunks_, coarse_;  // bytes
};

// The text of the kernels for devices; null: the build has none.
const char* rigid_sweep_kernels_text();

}  // namespace novaphy::detail
