#include "rigid_launches.h"

#include <algorithm>

#include "byte_array.h"
#include "novaphy/core/assert.h"
#include "novaphy/core/builtin_kernels.h"
#include "novaphy/core/scratch_rows.h"
#include "novaphy/core/sim/for_chunks.h"
#include "rigid_contact_kernels.h"
#include "rigid_contacts.h"
#include "rigid_mesh_kernels.h"

namespace novaphy::detail {
namespace {

// The number of rows that a thread of the CPU takes at a time: a few microseconds.
constexpr uint32_t kShapeRows = 96, kPairRows = 48;

// Never destroyed, because recordings refer to the kernels.
struct Kernels {
  Kernel<RigidContactShapeArguments> shape{kInChunks<rigid_contact_shape, kShapeRows>,
                                           rigid_contact_kernels_source};
  Kernel<RigidContactFindArguments> find{kInChunks<rigid_contact_find, kPairRows>,
                                         rigid_contact_kernels_source};
  Kernel<RigidContactChunkArguments> chunk{rigid_contact_chunk, rigid_contact_kernels_source};
  Kernel<RigidContactLimitSumArguments> limit_sum{rigid_contact_limit_sum,
                                                  rigid_contact_kernels_source};
  Kernel<RigidContactLimitArguments> limit{rigid_contact_limit, rigid_contact_kernels_source};
  Kernel<RigidContactFartherArguments> farther{rigid_contact_farther, rigid_contact_kernels_source};
  Kernel<RigidContactTrimArguments> trim{rigid_contact_trim, rigid_contact_kernels_source};
  Kernel<RigidContactWriteArguments> write{kInChunks<rigid_contact_write, kPairRows>,
                                           rigid_contact_kernels_source};
  Kernel<RigidContactClearArguments> clear{rigid_contact_clear, rigid_contact_kernels_source};
  Kernel<RigidMeshFindArguments> find_mesh{rigid_mesh_find, rigid_mesh_kernels_source};
  Kernel<RigidMeshLimitSumArguments> limit_sum_mesh{rigid_mesh_limit_sum,
                                                    rigid_mesh_kernels_source};
  Kernel<RigidMeshFartherArguments> farther_mesh{rigid_mesh_farther, rigid_mesh_kernels_source};
  Kernel<RigidMeshTrimArguments> trim_mesh{rigid_mesh_trim, rigid_mesh_kernels_source};
  Kernel<RigidMeshWriteArguments> write_mesh{rigid_mesh_write, rigid_mesh_kernels_source};
};
const Kernels& kernels() {
  static const auto& all = *new Kernels;
  return all;
}

template <class T>
T* memory_of(const Array& array) {
  return static_cast<T*>(array.range()->data());
}

int64_t chunks_of(int64_t pairs) { return (pairs + kScanChunk - 1) / kScanChunk; }

PairRows rows_of(const DeviceArray<int32_t>& counts, const DeviceArray<int32_t>& before) {
  return {.counts = counts, .before = before};
}
RigidContactRows rows_of(const Contacts& c) {
  return {.capacity = c.rigid_contact_max(),
          .rigid_contact_shape0 = c.rigid_contact_shape0,
          .rigid_contact_shape1 = c.rigid_contact_shape1,
          .rigid_contact_point0 = c.rigid_contact_point0,
          .rigid_contact_point1 = c.rigid_contact_point1,
          .rigid_contact_offset0 = c.rigid_contact_offset0,
          .rigid_contact_offset1 = c.rigid_contact_offset1,
          .rigid_contact_normal = c.rigid_contact_normal,
          .rigid_contact_margin0 = c.rigid_contact_margin0,
          .rigid_contact_margin1 = c.rigid_contact_margin1,
          .rigid_contact_point_id = c.rigid_contact_point_id};
}

}  // namespace

RigidContactShapeArguments RigidLaunches::shape_arguments(const Model& m, const SimState& state,
                                                          const ShapeGeometries& geometries,
                                                          float dt, const Array& views) {
  const auto count = static_cast<size_t>(m.shape_count());
  if (shapes_.rows() != count * sizeof(RigidShape))
    shapes_ = byte_array<RigidShape>(count, m.device());
  return {.shape_body = m.shape_body,
          .shape_type = m.shape_type,
          .shape_scale = m.shape_scale,
          .shape_transform = m.shape_transform,
          .shape_margin = m.shape_margin,
          .shape_gap = m.shape_gap,
          .body_q = state.body_q,
          .body_qd = state.body_qd,
          .body_com = m.body_com,
          .shape_material_ka = m.shape_material_ka,
          .dt = dt,
          .geometry = geometries.of_shape(),
          .views = Untyped(views),
          .shapes = Untyped(shapes_)};
}

void RigidLaunches::move(const Model& m, const SimState& state, const ShapeGeometries& geometries,
                         float dt) {
  const Array views = geometries.tables();
  run(kernels().shape, m.shape_count(), shape_arguments(m, state, geometries, dt, views));
}

void RigidLaunches::move_some(const Model& m, const SimState& state,
                              const ShapeGeometries& geometries, float dt,
                              std::span<const int32_t> moved) {
  const Array views = geometries.tables();
  const RigidContactShapeArguments a = in_memory(shape_arguments(m, state, geometries, dt, views));
  constexpr int64_t kChunk = 256;
  for_chunks(static_cast<int64_t>(moved.size()), kChunk, [&](int64_t begin, int64_t end, int64_t) {
    for (int64_t k = begin; k < end; ++k)
      rigid_contact_shape_row(a, moved[static_cast<size_t>(k)], m.shape_count());
  });
}

void RigidLaunches::reserve(const RigidPairs& pairs) {
  const size_t rows = pairs.rows().rows(), mesh_rows = pairs.mesh_rows().rows();
  const Device device = pairs.rows().device();
  if (filled_.rows() == 0) filled_ = DeviceArray<int32_t>(1, device);
  if (counts_.rows() != rows) {
    manifolds_ = byte_array<geometry::Manifold>(rows, device);
    counts_ = DeviceArray<int32_t>(rows, device);
    for (DeviceArray<int32_t>* of_chunks : {&before_, &sums_})
      *of_chunks = DeviceArray<int32_t>(static_cast<size_t>(chunks_of(rows)), device);
  }
  if (mesh_contacts_.rows() != mesh_rows * sizeof(MeshRows)) {
    mesh_contacts_ = byte_array<MeshRows>(mesh_rows, device);
    const size_t scratch = scratch_rows(device, mesh_rows);
    if (scratch > 0) mesh_scratch_ = byte_array<MeshContacts>(scratch, device);
  }
}

void RigidLaunches::find(const RigidPairs& pairs, int32_t contacts_per_pair) {
  reserve(pairs);
  run(kernels().find, pairs.count(),
      {.pairs_found = pairs.found(),
       .pairs = pairs.rows(),
       .shapes = Untyped(shapes_),
       .per_pair = contacts_per_pair,
       .manifolds = Untyped(manifolds_),
       .counts = counts_});
  run(kernels().find_mesh, pairs.mesh_count(),
      {.mesh_pairs = pairs.mesh_rows(),
       .pairs = pairs.rows(),
       .shapes = Untyped(shapes_),
       .scratch = Untyped(mesh_scratch_),
       .found = Untyped(mesh_contacts_),
       .counts = counts_});
}

void RigidLaunches::scan(const DeviceArray<int32_t>& counts, int64_t count,
                         const DeviceArray<int32_t>& before) {
  run(kernels().chunk, chunks_of(count), {.counts = counts, .pair_count = count, .sums = sums_});
  run(exclusive_scan(), chunks_of(count), {.in = sums_, .out = before});
}
void RigidLaunches::scan(const RigidPairs& pairs) { scan(counts_, pairs.count(), before_); }

// Finds the largest fraction of the gaps for which all rows fit.
void RigidLaunches::find_limit(const RigidPairs& pairs, int64_t capacity) {
  const int64_t count = pairs.count(), meshes = pairs.mesh_count();
  if (limit_.rows() == 0) {
    limit_sums_ = DeviceArray<int32_t>(kLimitSums * kLimitParts, counts_.device());
    limit_ = byte_array<RigidContactLimit>(1, counts_.device());
  }
  run(kernels().limit_sum, kLimitSums,
      {.pairs = pairs.rows(),
       .shapes = Untyped(shapes_),
       .manifolds = Untyped(manifolds_),
       .found = rows_of(counts_, before_),
       .pair_count = count,
       .capacity = capacity,
       .sums = limit_sums_});
  run(kernels().limit_sum_mesh, meshes > 0 ? kLimitSums : 0,
      {.mesh_pairs = pairs.mesh_rows(),
       .pairs = pairs.rows(),
       .shapes = Untyped(shapes_),
       .found = Untyped(mesh_contacts_),
       .mesh_pair_count = meshes,
       .sums = limit_sums_});
  run(kernels().limit, 1,
      {.found = rows_of(counts_, before_),
       .sums = limit_sums_,
       .pair_count = count,
       .capacity = capacity,
       .rows = kLimitSums,
       .limit = Untyped(limit_)});
}

void RigidLaunches::limit(const RigidPairs& pairs, int64_t capacity) {
  find_limit(pairs, capacity);
  const int64_t count = pairs.count(), meshes = pairs.mesh_count();
  if (farther_.rows() != counts_.rows()) {
    farther_ = DeviceArray<int32_t>(counts_.rows(), counts_.device());
    farther_before_ = DeviceArray<int32_t>(before_.rows(), counts_.device());
  }
  run(kernels().farther, count,
      {.limit = Untyped(limit_),
       .pairs = pairs.rows(),
       .shapes = Untyped(shapes_),
       .manifolds = Untyped(manifolds_),
       .counts = counts_,
       .farther = farther_});
  run(kernels().farther_mesh, meshes,
      {.limit = Untyped(limit_),
       .mesh_pairs = pairs.mesh_rows(),
       .pairs = pairs.rows(),
       .shapes = Untyped(shapes_),
       .found = Untyped(mesh_contacts_),
       .farther = farther_});
  scan(farther_, count, farther_before_);
  run(kernels().trim, count,
      {.limit = Untyped(limit_),
       .pairs = pairs.rows(),
       .shapes = Untyped(shapes_),
       .farther = rows_of(farther_, farther_before_),
       .manifolds = Untyped(manifolds_),
       .counts = counts_});
  run(kernels().trim_mesh, meshes,
      {.limit = Untyped(limit_),
       .mesh_pairs = pairs.mesh_rows(),
       .pairs = pairs.rows(),
       .shapes = Untyped(shapes_),
       .farther = rows_of(farther_, farther_before_),
       .found = Untyped(mesh_contacts_),
       .counts = counts_});
  scan(pairs);
}

void RigidLaunches::write(const RigidPairs& pairs, bool limited, const Contacts& c) {
  const Array none;
  run(kernels().write, pairs.count(),
      {.limit = Untyped(limited ? limit_ : none),
       .pairs_found = pairs.found(),
       .pairs = pairs.rows(),
       .shapes = Untyped(shapes_),
       .manifolds = Untyped(manifolds_),
       .found = rows_of(counts_, before_),
       .rigid_contact_count = c.rigid_contact_count,
       .rows = rows_of(c),
       .rows_filled = filled_});
  run(kernels().write_mesh, pairs.mesh_count(),
      {.mesh_pairs = pairs.mesh_rows(),
       .pairs = pairs.rows(),
       .shapes = Untyped(shapes_),
       .found = Untyped(mesh_contacts_),
       .of_pairs = rows_of(counts_, before_),
       .rows = rows_of(c)});
}

void RigidLaunches::clear(int64_t pairs, int64_t last, const Contacts& c) {
  const Array none;
  run(kernels().clear, last + 1,
      {.pairs = pairs,
       .rigid_contact_count = c.rigid_contact_count,
       .rows_filled = Untyped(pairs > 0 ? filled_ : none),
       .shape0 = c.rigid_contact_shape0,
       .rows = rows_of(c),
       .rigid_contact_force = c.rigid_contact_force});
}

std::span<const RigidShape> RigidLaunches::host_shapes() const {
  if (shapes_.rows() == 0) return {};
  return {memory_of<RigidShape>(shapes_), shapes_.rows() / sizeof(RigidShape)};
}
geometry::Manifold* RigidLaunches::host_manifolds() const {
  return memory_of<geometry::Manifold>(manifolds_);
}
int32_t* RigidLaunches::host_counts() const { return memory_of<int32_t>(counts_); }

int64_t RigidLaunches::rows_found(const RigidPairs& pairs) const {
  const UntrackedScope untracked;
  NOVAPHY_ASSERT(std::is_sorted(before_.data(), before_.data() + chunks_of(pairs.count())));
  return rows_up_to({.counts = direct(counts_.data()), .before = direct(before_.data())},
                    pairs.count() - 1);
}

}  // namespace novaphy::detail
