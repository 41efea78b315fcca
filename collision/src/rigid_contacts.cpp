#include "rigid_contacts.h"

#include <algorithm>
#include <array>
#include <utility>
#include <vector>

#include "novaphy/core/device_kernel.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"
#include "rigid_contact_kernels.h"

namespace novaphy::detail {
namespace {

// Never destroyed: recordings refer to them.
struct Kernels {
  DeviceKernel shape{rigid_contact_shape, rigid_contact_kernels_text};
  DeviceKernel find{rigid_contact_find, rigid_contact_kernels_text};
  DeviceKernel scan{"exclusive_scan_i32"};
  DeviceKernel write{rigid_contact_write, rigid_contact_kernels_text};
  DeviceKernel clear{rigid_contact_clear, rigid_contact_kernels_text};
};
const Kernels& kernels() {
  static const auto& all = *new Kernels;
  return all;
}

// The most contacts of a pair of types, in their order; 0 if the pair is not covered.
int32_t most_contacts(GeoType a, GeoType b, int32_t per_pair) {
  const auto is_convex = [](GeoType type) {
    return geometry::is_convex_type(type) && type != GeoType::CONVEX_MESH;
  };
  if (a != GeoType::PLANE)
    return !is_convex(a) || !is_convex(b) ? 0 : a == GeoType::SPHERE ? 1 : per_pair;
  switch (b) {
    case GeoType::SPHERE:
    case GeoType::ELLIPSOID:
      return 1;
    case GeoType::CAPSULE:
      return 2;
    case GeoType::BOX:
      return 4;
    case GeoType::CYLINDER:
    case GeoType::CONE:
      return 5;
    default:
      return 0;
  }
}

}  // namespace

struct RigidContacts::Impl {
  std::shared_ptr<const Model> model;
  BroadPhase broad_phase;
  int32_t contacts_per_pair = 0;
  // The candidate pairs follow from arrays of the model in these versions.
  bool known = false;
  uint64_t versions[7] = {};
  int64_t most_rows = 0;
  DeviceArray<Vec2i> pairs;  // (shape0, shape1) of the contacts, in ascending order
  // Scratch, kept from call to call.
  std::shared_ptr<Storage> shapes, manifolds;
  DeviceArray<int32_t> counts, before;

  std::array<const Array*, 7> choosing() const {
    const Model& m = *model;
    return {&m.shape_body,  &m.shape_type,  &m.shape_contact_pairs,  &m.shape_scale,
            &m.shape_flags, &m.shape_world, &m.shape_collision_group};
  }
  bool up_to_date() const {
    const auto arrays = choosing();
    for (size_t k = 0; k < arrays.size(); ++k) {
      const auto& range = arrays[k]->range();
      if (versions[k] != arrays[k]->version() || (range && range->was_exported())) return false;
    }
    return known;
  }

  void find_candidates() {
    if (up_to_date()) return;
    const Model& m = *model;
    const std::vector<int32_t> body = m.shape_body.to_host(), type = m.shape_type.to_host();
    const std::vector<Vec3f> scale = m.shape_scale.to_host();
    std::vector<Vec2i> found =
        broad_phase == BroadPhase::Explicit
            ? m.shape_contact_pairs.to_host()
            : make_shape_contact_pairs(body, m.shape_flags.to_host(),
                                       m.shape_collision_group.to_host(), m.shape_world.to_host(),
                                       m.shape_collision_filter_pairs);
    int64_t rows = 0;
    for (Vec2i& pair : found) {
      require(pair.x >= 0 && pair.y >= 0 && pair.x < m.shape_count() && pair.y < m.shape_count(),
              ErrorKind::Index, "CollisionPipeline: model.shape_contact_pairs: expected shapes ",
              "from 0 to ", m.shape_count() - 1, ", got (", pair.x, ", ", pair.y, ")");
      const auto type_of = [&](int32_t s) {
        return static_cast<GeoType>(type[static_cast<size_t>(s)]);
      };
      if (type_of(pair.x) > type_of(pair.y)) std::swap(pair.x, pair.y);
      const GeoType a = type_of(pair.x), b = type_of(pair.y);
      const int32_t most = most_contacts(a, b, contacts_per_pair);
      require(most > 0, ErrorKind::NotImplemented, "CollisionPipeline: shapes ", pair.x, " (",
              geo_type_name(a), ") and ", pair.y, " (", geo_type_name(b),
              ") may meet, and this pair of types is not there yet; "
              "ModelBuilder.add_shape_collision_filter_pair or collision groups part them");
      const Vec3f& size = scale[static_cast<size_t>(pair.x)];
      require(a != GeoType::PLANE || !(size.x > 0.0f && size.y > 0.0f), ErrorKind::NotImplemented,
              "CollisionPipeline: shape ", pair.x,
              ": expected an infinite plane (width and length "
              "0) for contacts with shapes, got one of ",
              size.x, " by ", size.y);
      rows += most;
    }
    std::sort(found.begin(), found.end(),
              [](const Vec2i& a, const Vec2i& b) { return a.x != b.x ? a.x < b.x : a.y < b.y; });
    const Device device = m.device();
    pairs = DeviceArray<Vec2i>::from_host(found, device);
    shapes = Storage::allocate(body.size() * sizeof(RigidShape), device);
    manifolds = Storage::allocate(found.size() * sizeof(geometry::Manifold), device);
    counts = DeviceArray<int32_t>(found.size(), device);
    before = DeviceArray<int32_t>(found.size(), device);
    most_rows = rows;
    const auto arrays = choosing();
    for (size_t k = 0; k < arrays.size(); ++k) versions[k] = arrays[k]->version();
    known = true;
  }
  // The pairs follow from what the host has read.
  void depend_on_candidates() const {
    LaunchRecorder* const recorder = launch_recorder();
    if (recorder == nullptr) return;
    for (const Array* array : choosing())
      if (array->range()) recorder->depends_on(array->range());
  }
};

RigidContacts::RigidContacts(std::shared_ptr<const Model> model, BroadPhase broad_phase,
                             int32_t contacts_per_pair)
    : impl_(std::make_unique<Impl>()) {
  impl_->model = std::move(model);
  impl_->broad_phase = broad_phase;
  impl_->contacts_per_pair = contacts_per_pair;
}
RigidContacts::~RigidContacts() = default;

int64_t RigidContacts::most_rows() {
  impl_->find_candidates();
  return impl_->most_rows;
}

void RigidContacts::collide(const SimState& state, Contacts& c) {
  const Model& m = *impl_->model;
  const Device device = m.device();
  impl_->find_candidates();
  impl_->depend_on_candidates();
  const auto pairs = static_cast<int64_t>(impl_->pairs.rows());
  const int64_t rows = c.rigid_contact_max();
  // What a row holds carries no gradient, so nothing that the search reads needs one.
  const auto constant = [](const char* name, const Array& array) {
    return reads(name, array).detached();
  };
  if (pairs > 0) {
    const auto bytes = [](const std::shared_ptr<Storage>& storage) {
      return Array(DType::uint8, storage->bytes(), 1, storage->range());
    };
    const Array shapes = bytes(impl_->shapes), manifolds = bytes(impl_->manifolds);
    kernels().shape.launch(
        device, m.shape_count(),
        {reads_row("shape_body", m.shape_body), reads_row("shape_type", m.shape_type),
         constant("shape_scale", m.shape_scale), constant("shape_transform", m.shape_transform),
         constant("shape_margin", m.shape_margin), constant("shape_gap", m.shape_gap),
         constant("body_q", state.body_q), writes("shapes", shapes)});
    kernels().find.launch(device, pairs,
                          {reads_row("pairs", impl_->pairs), reads("shapes", shapes),
                           number(int64_t{impl_->contacts_per_pair}),
                           writes("manifolds", manifolds), writes_row("counts", impl_->counts)});
    kernels().scan.launch(device, pairs,
                          {reads("counts", impl_->counts), writes("before", impl_->before)});
    kernels().write.launch(
        device, pairs,
        {reads_row("pairs", impl_->pairs), reads("shapes", shapes), reads("manifolds", manifolds),
         reads_row("counts", impl_->counts), reads_row("before", impl_->before), number(rows),
         writes("rigid_contact_count", c.rigid_contact_count),
         writes("rigid_contact_shape0", c.rigid_contact_shape0),
         writes("rigid_contact_shape1", c.rigid_contact_shape1),
         writes("rigid_contact_point0", c.rigid_contact_point0),
         writes("rigid_contact_point1", c.rigid_contact_point1),
         writes("rigid_contact_offset0", c.rigid_contact_offset0),
         writes("rigid_contact_offset1", c.rigid_contact_offset1),
         writes("rigid_contact_normal", c.rigid_contact_normal),
         writes("rigid_contact_margin0", c.rigid_contact_margin0),
         writes("rigid_contact_margin1", c.rigid_contact_margin1),
         writes("rigid_contact_point_id", c.rigid_contact_point_id)});
  }
  kernels().clear.launch(device, rows + 1,
                         {number(pairs), updates("rigid_contact_count", c.rigid_contact_count),
                          writes("rigid_contact_shape0", c.rigid_contact_shape0),
                          writes("rigid_contact_shape1", c.rigid_contact_shape1),
                          writes("rigid_contact_point0", c.rigid_contact_point0),
                          writes("rigid_contact_point1", c.rigid_contact_point1),
                          writes("rigid_contact_offset0", c.rigid_contact_offset0),
                          writes("rigid_contact_offset1", c.rigid_contact_offset1),
                          writes("rigid_contact_normal", c.rigid_contact_normal),
                          writes("rigid_contact_margin0", c.rigid_contact_margin0),
                          writes("rigid_contact_margin1", c.rigid_contact_margin1),
                          writes("rigid_contact_point_id", c.rigid_contact_point_id),
                          writes("rigid_contact_force", c.rigid_contact_force)});
}

}  // namespace novaphy::detail
