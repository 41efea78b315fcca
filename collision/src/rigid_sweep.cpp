#include "rigid_sweep.h"

#include <algorithm>
#include <vector>

#include "byte_array.h"
#include "novaphy/core/builtin_kernels.h"
#include "novaphy/core/error.h"
#include "rigid_sweep_kernels.h"
#include "sweep_axis.h"

namespace novaphy::detail {
namespace {

// Never destroyed: recordings refer to them.
struct Kernels {
  Kernel<RigidSweepKeyArguments> key{rigid_sweep_key, rigid_sweep_kernels_text};
  Kernel<RigidSweepWorldArguments> world{rigid_sweep_world, rigid_sweep_kernels_text};
  Kernel<RigidSweepSortArguments> entry{rigid_sweep_sort, rigid_sweep_kernels_text};
  Kernel<RigidSweepChunkArguments> chunk{rigid_sweep_chunk, rigid_sweep_kernels_text};
  Kernel<RigidSweepCountArguments> count{rigid_sweep_count, rigid_sweep_kernels_text};
  Kernel<RigidSweepTotalArguments> total{rigid_sweep_total, rigid_sweep_kernels_text};
  Kernel<RigidSweepWriteArguments> write{rigid_sweep_write, rigid_sweep_kernels_text};
};
const Kernels& kernels() {
  static const auto& all = *new Kernels;
  return all;
}

constexpr int64_t kTotals = 256;
constexpr int64_t kMostUnwrapped = 65536;  // shapes whose pairs int32 counts

int64_t chunks_of(int64_t count) { return (count + kSweepChunk - 1) / kSweepChunk; }

// The axis on which the shapes lie farthest apart where the model has its bodies.
int64_t axis_of(const Model& m) {
  const std::vector<int32_t> body = m.shape_body.to_host();
  const std::vector<Transformf> at = m.shape_transform.to_host(), q = m.body_q.to_host();
  std::vector<geometry::Box3> points;
  for (size_t s = 0; s < body.size(); ++s) {
    const Vec3f p =
        body[s] < 0 ? at[s].p : math::transform_point(q[static_cast<size_t>(body[s])], at[s].p);
    points.push_back({p, p});
  }
  return sweep_axis(points);
}

}  // namespace

void RigidSweep::update(const Model& m, std::span<const int32_t> world) {
  const Device device = m.device();
  const size_t shapes = world.size();
  for (size_t s = 0; s < shapes; ++s)
    require(world[s] < m.world_count(), ErrorKind::Index, "CollisionPipeline: model.shape_world[",
            s, "]: expected at most ", m.world_count() - 1, ", got ", world[s]);
  axis_ = axis_of(m);
  segments_ = int64_t{m.world_count()} + 1;
  std::vector<std::vector<int32_t>> partners(shapes);
  for (const auto& [i, j] : m.shape_collision_filter_pairs) {
    if (i < 0 || j < 0 || static_cast<size_t>(std::max(i, j)) >= shapes) continue;
    partners[static_cast<size_t>(i)].push_back(j);
    partners[static_cast<size_t>(j)].push_back(i);
  }
  std::vector<int32_t> starts = {0}, filtered;
  for (const std::vector<int32_t>& of_shape : partners) {
    filtered.insert(filtered.end(), of_shape.begin(), of_shape.end());
    starts.push_back(static_cast<int32_t>(filtered.size()));
  }
  filter_starts_ = DeviceArray<int32_t>::from_host(starts, device);
  filtered_ = DeviceArray<int32_t>::from_host(filtered, device);
  for (DeviceArray<int32_t>* table : {&keys_, &order_, &world_keys_, &items_, &counts_, &before_})
    *table = DeviceArray<int32_t>(shapes, device);
  starts_ = DeviceArray<int32_t>(static_cast<size_t>(segments_) + 1, device);
  found_ = DeviceArray<int32_t>(1, device);
  totals_ = {};
  if (m.shape_count() > kMostUnwrapped) totals_ = DeviceArray<uint64_t>(kTotals, device);
  const int64_t chunks = chunks_of(m.shape_count());
  entries_ = byte_array<SweepEntry>(shapes, device);
  chunks_ = byte_array<SweepInterval>(static_cast<size_t>(chunks), device);
  coarse_ = byte_array<SweepInterval>(static_cast<size_t>(chunks_of(chunks)), device);
}

RigidSweepTables RigidSweep::tables(const Model& m, const Array& shapes) const {
  return {.shapes = Untyped(shapes),
          .body = m.shape_body,
          .flags = m.shape_flags,
          .group = m.shape_collision_group,
          .world = m.shape_world,
          .filter_starts = filter_starts_,
          .filtered = filtered_,
          .entries = Untyped(entries_),
          .chunks = Untyped(chunks_),
          .coarse = Untyped(coarse_),
          .starts = starts_,
          .segments = segments_,
          .axis = axis_};
}

void RigidSweep::sort(const Model& m, const Array& shapes) {
  const Kernels& k = kernels();
  const int64_t count = m.shape_count(), chunks = chunks_of(count);
  run(k.key, count, {.shapes = Untyped(shapes), .axis = axis_, .keys = keys_});
  run(sort_by_key(), count, {.keys = keys_, .order = order_});
  run(k.world, count,
      {.shapes = Untyped(shapes),
       .order = order_,
       .world = m.shape_world,
       .segments = world_keys_});
  run(incidence(), segments_,
      {.table = world_keys_, .slots = count, .offsets = starts_, .items = items_});
  run(k.entry, count,
      {.shapes = Untyped(shapes),
       .order = order_,
       .starts = starts_,
       .items = items_,
       .segments = segments_,
       .entries = Untyped(entries_)});
  run(k.chunk, chunks,
      {.entries = Untyped(entries_),
       .below = nullptr,
       .count = count,
       .axis = axis_,
       .chunks = Untyped(chunks_)});
  run(k.chunk, chunks_of(chunks),
      {.entries = Untyped(entries_),
       .below = Untyped(chunks_),
       .count = chunks,
       .axis = axis_,
       .chunks = Untyped(coarse_)});
  run(k.count, count, {.sweep = tables(m, shapes), .counts = counts_});
  run(exclusive_scan(), count, {.in = counts_, .out = before_});
  if (totals_.rows() > 0)
    run(k.total, kTotals, {.counts = counts_, .shapes = count, .totals = totals_});
}

void RigidSweep::write(const Model& m, const Array& shapes, const DeviceArray<Vec2i>& pairs) {
  run(kernels().write, m.shape_count(),
      {.sweep = tables(m, shapes),
       .counts = counts_,
       .before = before_,
       .totals = totals_,
       .total_rows = kTotals,
       .capacity = pairs.rows(),
       .pairs = pairs,
       .pairs_found = found_});
}

}  // namespace novaphy::detail
