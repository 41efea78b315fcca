#include "rigid_sweep.h"

#include <algorithm>
#include <vector>

#include "novaphy/core/device_kernel.h"
#include "novaphy/core/error.h"
#include "rigid_sweep_kernels.h"
#include "sweep_axis.h"

namespace novaphy::detail {
namespace {

// Never destroyed: recordings refer to them.
struct Kernels {
  DeviceKernel key{rigid_sweep_key, rigid_sweep_kernels_text};
  DeviceKernel sort{"sort_by_key_i32"};
  DeviceKernel world{rigid_sweep_world, rigid_sweep_kernels_text};
  DeviceKernel by_world{"incidence_i32"};
  DeviceKernel entry{rigid_sweep_sort, rigid_sweep_kernels_text};
  DeviceKernel chunk{rigid_sweep_chunk, rigid_sweep_kernels_text};
  DeviceKernel count{rigid_sweep_count, rigid_sweep_kernels_text};
  DeviceKernel total{rigid_sweep_total, rigid_sweep_kernels_text};
  DeviceKernel scan{"exclusive_scan_i32"};
  DeviceKernel write{rigid_sweep_write, rigid_sweep_kernels_text};
};
const Kernels& kernels() {
  static const auto& all = *new Kernels;
  return all;
}

constexpr int64_t kTotals = 256;
constexpr int64_t kMostUnwrapped = 65536;  // shapes whose pairs int32 counts

Array bytes(const std::shared_ptr<Storage>& storage) {
  return {DType::uint8, storage->bytes(), 1, storage->range()};
}
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

void RigidSweep::update(const Model& m, std::span<const int32_t> world,
                        const std::set<std::pair<int32_t, int32_t>>& left_out) {
  const Device device = m.device();
  const size_t shapes = world.size();
  for (size_t s = 0; s < shapes; ++s)
    require(world[s] < m.world_count(), ErrorKind::Index, "CollisionPipeline: model.shape_world[",
            s, "]: expected at most ", m.world_count() - 1, ", got ", world[s]);
  axis_ = axis_of(m);
  segments_ = int64_t{m.world_count()} + 1;
  std::vector<std::vector<int32_t>> partners(shapes);
  for (const auto* pairs : {&m.shape_collision_filter_pairs, &left_out})
    for (const auto& [i, j] : *pairs) {
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
  entries_ = Storage::allocate(shapes * sizeof(SweepEntry), device);
  chunks_ = Storage::allocate(static_cast<size_t>(chunks) * sizeof(SweepInterval), device);
  coarse_ =
      Storage::allocate(static_cast<size_t>(chunks_of(chunks)) * sizeof(SweepInterval), device);
}

// The arguments of a struct RigidSweep, then the others.
#define NOVAPHY_SWEEP_ARGUMENTS(m, shapes)                                                        \
  reads("shapes", shapes), reads("shape_body", (m).shape_body),                                   \
      reads("shape_flags", (m).shape_flags),                                                      \
      reads("shape_collision_group", (m).shape_collision_group),                                  \
      reads("shape_world", (m).shape_world), reads("filter_starts", filter_starts_),              \
      reads("filtered", filtered_), reads("entries", bytes(entries_)),                            \
      reads("chunks", bytes(chunks_)), reads("coarse", bytes(coarse_)), reads("starts", starts_), \
      number(segments_), number(axis_)

void RigidSweep::sort(const Model& m, const Array& shapes) {
  const Kernels& k = kernels();
  const Device device = m.device();
  const int64_t count = m.shape_count(), chunks = chunks_of(count);
  k.key.launch(device, count, {reads("shapes", shapes), number(axis_), writes_row("keys", keys_)});
  k.sort.launch(device, count, {reads("keys", keys_), writes("order", order_)});
  k.world.launch(device, count,
                 {reads("shapes", shapes), reads_row("order", order_),
                  reads("shape_world", m.shape_world), writes_row("segments", world_keys_)});
  k.by_world.launch(device, segments_,
                    {reads("segments", world_keys_), number(count), writes("starts", starts_),
                     writes("items", items_)});
  k.entry.launch(device, count,
                 {reads("shapes", shapes), reads("order", order_), reads("starts", starts_),
                  reads("items", items_), number(segments_), writes("entries", bytes(entries_))});
  k.chunk.launch(device, chunks,
                 {reads("entries", bytes(entries_)), reads("below", Array()), number(count),
                  number(axis_), writes("chunks", bytes(chunks_))});
  k.chunk.launch(device, chunks_of(chunks),
                 {reads("entries", bytes(entries_)), reads("below", bytes(chunks_)), number(chunks),
                  number(axis_), writes("chunks", bytes(coarse_))});
  k.count.launch(device, count,
                 {NOVAPHY_SWEEP_ARGUMENTS(m, shapes), writes_row("counts", counts_)});
  k.scan.launch(device, count, {reads("counts", counts_), writes("before", before_)});
  if (totals_.rows() > 0)
    k.total.launch(device, kTotals,
                   {reads("counts", counts_), number(count), writes_row("totals", totals_)});
}

void RigidSweep::write(const Model& m, const Array& shapes, const DeviceArray<Vec2i>& pairs) {
  kernels().write.launch(m.device(), m.shape_count(),
                         {NOVAPHY_SWEEP_ARGUMENTS(m, shapes), reads_row("counts", counts_),
                          reads_row("before", before_), reads("totals", totals_), number(kTotals),
                          number(static_cast<int64_t>(pairs.rows())), writes("pairs", pairs),
                          writes("pairs_found", found_)});
}

}  // namespace novaphy::detail
