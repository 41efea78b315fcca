// The tables and the memory of the coarse correction of VBD (coarse_kernels.h).
#pragma once

#include <vector>

#include "color_slots.h"
#include "novaphy/core/device_array.h"
#include "vbd_coarse_kernels.h"

namespace novaphy::vbd {

// The systems, aggregates and functions of the coarse correction, on the host; see
// VbdCoarseArguments.
//
// A system is a connected component of at least two particles that move. An aggregate has about
// kParticles particles. Its size grows if the system would otherwise have more than kUnknowns
// unknowns.
struct CoarseTables {
  static constexpr int kParticles = 10, kUnknowns = 300;

  // `model` must be on the host. The linear functions of an aggregate (coarse_kernels.h) are linear
  // in the model's particle_q. A function that is constant over its aggregate is left out.
  CoarseTables(const Model& model, const ColorSlots& slots);

  std::vector<int32_t> aggregate, near_begin, near, function_begin, member_begin, members;
  std::vector<int32_t> function_aggregate, pairs, system, system_begin, is_free;
  std::vector<int64_t> near_row, matrix_begin;
  std::vector<VbdRow> field;
  int64_t matrix_end = 0;

 private:
  using Points = std::vector<Vec3<double>>;
  void find_near(const ColorSlots& slots);
  void split(const Points& points, std::vector<int32_t>& particles, size_t begin, size_t end,
             int64_t parts);
  void add_aggregate(const Points& points, std::vector<int32_t> particles);
  void add_pairs();
};

class Coarse {
 public:
  Coarse(const Model& model, const ColorSlots& slots, Device device);

  // Returns the arguments of a launch over all groups. `tests`: number of tests of the line search
  // that ran before.
  VbdCoarseArguments arguments(const VbdSweepArguments& sweep, int64_t tests) const;
  int64_t systems() const { return static_cast<int64_t>(matrix_begin_.rows()); }
  int64_t threads() const { return systems() * kBlockRows; }  // of all blocks
  int64_t functions() const { return static_cast<int64_t>(function_aggregate_.rows()); }
  int64_t pairs() const { return static_cast<int64_t>(pairs_.rows() / 2); }
  const DeviceArray<float>& matrix() const { return matrix_; }
  // Returns the line searches of the last correction. vbd_keep copies them.
  const DeviceArray<Vec4f>& search() const { return search_; }

 private:
  explicit Coarse(const CoarseTables& tables, Device device);

  DeviceArray<int32_t> aggregate_, near_begin_, near_, function_begin_, member_begin_, members_;
  DeviceArray<int32_t> function_aggregate_, pairs_, system_, system_begin_, is_free_;
  DeviceArray<uint64_t> near_row_, matrix_begin_;
  DeviceArray<Vec4f> field_, force_, search_, shift_;
  DeviceArray<float> rows_, matrix_, load_, step_;
};

}  // namespace novaphy::vbd
