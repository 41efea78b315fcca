#include "rigid_contacts.h"

#include <algorithm>
#include <array>
#include <limits>
#include <map>
#include <utility>
#include <vector>

#include "fcl_penetration.h"
#include "novaphy/collision/box_pairs.h"
#include "novaphy/core/array_stamp.h"
#include "novaphy/core/assert.h"
#include "novaphy/core/device_kernel.h"
#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/model_builder.h"
#include "rigid_contact_kernels.h"
#include "rigid_mesh_kernels.h"
#include "rigid_sweep.h"

namespace novaphy::detail {
namespace {

// Never destroyed: recordings refer to them.
struct Kernels {
  DeviceKernel shape{rigid_contact_shape, rigid_contact_kernels_text};
  DeviceKernel find{rigid_contact_find, rigid_contact_kernels_text};
  DeviceKernel scan{"exclusive_scan_i32"};
  DeviceKernel limit_sum{rigid_contact_limit_sum, rigid_contact_kernels_text};
  DeviceKernel limit{rigid_contact_limit, rigid_contact_kernels_text};
  DeviceKernel farther{rigid_contact_farther, rigid_contact_kernels_text};
  DeviceKernel trim{rigid_contact_trim, rigid_contact_kernels_text};
  DeviceKernel write{rigid_contact_write, rigid_contact_kernels_text};
  DeviceKernel clear{rigid_contact_clear, rigid_contact_kernels_text};
  DeviceKernel find_mesh{rigid_mesh_find, rigid_mesh_kernels_text};
  DeviceKernel limit_sum_mesh{rigid_mesh_limit_sum, rigid_mesh_kernels_text};
  DeviceKernel farther_mesh{rigid_mesh_farther, rigid_mesh_kernels_text};
  DeviceKernel trim_mesh{rigid_mesh_trim, rigid_mesh_kernels_text};
  DeviceKernel write_mesh{rigid_mesh_write, rigid_mesh_kernels_text};
};
const Kernels& kernels() {
  static const auto& all = *new Kernels;
  return all;
}

// The most contacts of a pair of types, in their order; 0 if the pair is not covered.
int32_t most_contacts(GeoType a, GeoType b, int32_t per_pair) {
  using geometry::is_convex_type;
  if (is_mesh_pair(a, b)) {
    const GeoType other = a == GeoType::MESH ? b : a;
    return is_convex_type(other) || other == GeoType::MESH ? geometry::kMeshContacts : 0;
  }
  if (a != GeoType::PLANE)
    return !is_convex_type(a) || !is_convex_type(b) ? 0 : a == GeoType::SPHERE ? 1 : per_pair;
  switch (b) {
    case GeoType::SPHERE:
    case GeoType::ELLIPSOID:
      return 1;
    case GeoType::CAPSULE:
      return 2;
    case GeoType::BOX:
    case GeoType::MESH:
    case GeoType::CONVEX_MESH:
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
  NarrowPhase narrow_phase;
  int32_t contacts_per_pair = 0;
  std::optional<std::vector<Vec2i>> explicit_pairs;  // instead of the model's
  std::shared_ptr<ShapeGeometries> geometries;
  // The candidate pairs follow from arrays of the model in these versions.
  ArrayVersions<7> versions;
  std::vector<int32_t> body, type, flags, group, world;  // of the shapes
  std::vector<Vec3f> scale;
  SweepAndPrune sweep;
  RigidSweep kernel_sweep;          // on devices, and what is recorded
  bool kernel_sweep_known = false;  // its tables
  std::vector<geometry::Box3> boxes;
  int64_t most_rows = 0;
  int64_t pair_count = 0;
  DeviceArray<Vec2i> pairs;  // (shape0, shape1) of the contacts, in ascending order
  std::map<const geometry::GeometryView*, FclHull> fcl_hulls;  // of the tables of fcl_version
  uint64_t fcl_version = 0;
  int64_t fcl_pairs = 0, fcl_fallbacks = 0;
  int64_t mesh_pair_count = 0;
  DeviceArray<int32_t> mesh_pairs;  // rows of `pairs` with a mesh and no plane
  // Scratch, kept from call to call.
  std::shared_ptr<Storage> shapes, manifolds, mesh_rows, mesh_scratch;
  DeviceArray<int32_t> counts, before;
  DeviceArray<int32_t> limit_sums, farther, farther_before;
  std::shared_ptr<Storage> limit;  // a RigidContactLimit
  // rigid_contact_shape0 as the last call left it, empty behind `used` rows.
  ArrayStamp emptied;
  int64_t used = 0;

  std::array<const Array*, 7> choosing() const {
    const Model& m = *model;
    return {&m.shape_body,  &m.shape_type,  &m.shape_contact_pairs,  &m.shape_scale,
            &m.shape_flags, &m.shape_world, &m.shape_collision_group};
  }
  ShapePairRules rules() const {
    return {body, flags, group, world, &model->shape_collision_filter_pairs};
  }

  // Puts a pair in its order. Returns the most rows that it can have.
  int32_t orient(Vec2i& pair) const {
    const int32_t last = model->shape_count() - 1;
    require(pair.x >= 0 && pair.y >= 0 && pair.x <= last && pair.y <= last, ErrorKind::Index,
            "CollisionPipeline: model.shape_contact_pairs: expected shapes from 0 to ", last,
            ", got (", pair.x, ", ", pair.y, ")");
    const auto type_of = [&](int32_t s) {
      return static_cast<GeoType>(type[static_cast<size_t>(s)]);
    };
    if (type_of(pair.x) > type_of(pair.y)) std::swap(pair.x, pair.y);
    const GeoType a = type_of(pair.x), b = type_of(pair.y);
    const int32_t most = most_contacts(a, b, contacts_per_pair);
    require(most > 0, ErrorKind::NotImplemented, "CollisionPipeline: shapes ", pair.x, " (",
            geo_type_name(a), ") and ", pair.y, " (", geo_type_name(b),
            ") may meet, and this pair of types is not there yet; ",
            explicit_pairs ? "leave it out of shape_pairs_filtered"
                           : "ModelBuilder.add_shape_collision_filter_pair or collision groups "
                             "part them");
    // On a GPU their normals and names were seen to differ from the CPU's in some rows.
    require(model->device().is_cpu() || !is_mesh_pair(a, b), ErrorKind::NotImplemented,
            "CollisionPipeline: shapes ", pair.x, " (", geo_type_name(a), ") and ", pair.y, " (",
            geo_type_name(b), ") may meet: contacts of meshes are found on the cpu, not on ",
            model->device().str());
    const Vec3f& size = scale[static_cast<size_t>(pair.x)];
    require(a != GeoType::PLANE || !(size.x > 0.0f && size.y > 0.0f), ErrorKind::NotImplemented,
            "CollisionPipeline: shape ", pair.x,
            ": expected an infinite plane (width and length 0) for contacts with shapes, got one "
            "of ",
            size.x, " by ", size.y);
    return most;
  }
  // Takes pairs (i < j) as those to look at. Returns the most rows that they can have.
  int64_t take(std::vector<Vec2i> found) {
    int64_t rows = 0;
    for (Vec2i& pair : found) rows += orient(pair);
    const auto before_other = [](const Vec2i& a, const Vec2i& b) {
      return a.x != b.x ? a.x < b.x : a.y < b.y;
    };
    if (!std::is_sorted(found.begin(), found.end(), before_other))
      std::sort(found.begin(), found.end(), before_other);
    make_room(found.size());
    pair_count = static_cast<int64_t>(found.size());
    NOVAPHY_ASSERT(found.size() <= pairs.rows());
    take_mesh_pairs(found);
    found.resize(pairs.rows());
    pairs.copy_from_host(std::span<const Vec2i>(found));
    return rows;
  }

  void make_room(size_t count) {
    if (count <= pairs.rows() && pairs.rows() != 0) return;
    const Device device = model->device();
    pairs = DeviceArray<Vec2i>(count, device);
    manifolds = Storage::allocate(count * sizeof(geometry::Manifold), device);
    counts = DeviceArray<int32_t>(count, device);
    before = DeviceArray<int32_t>(count, device);
  }

  // Takes FCL's answers for the pairs of hulls whose contacts were found.
  void ask_fcl() {
    if (fcl_version != geometries->version()) {
      fcl_hulls.clear();
      fcl_version = geometries->version();
    }
    const auto* const moved = static_cast<const RigidShape*>(shapes->range()->data());
    auto* const manifold = static_cast<geometry::Manifold*>(manifolds->range()->data());
    auto* const count = static_cast<int32_t*>(counts.range()->data());
    for (int64_t k = 0; k < pair_count; ++k) {
      const Vec2i pair = pairs.data()[k];
      const RigidShape &s0 = moved[pair.x], &s1 = moved[pair.y];
      if (s0.type != GeoType::CONVEX_MESH || s1.type != GeoType::CONVEX_MESH ||
          !geometry::boxes_meet(s0.box, s1.box))
        continue;
      if (penetration_of(s0, s1, count[k] > 0 ? &manifold[k] : nullptr, manifold[k]))
        count[k] = manifold[k].count;
    }
  }
  const FclHull& fcl_hull(const RigidShape& shape) {
    const auto at = fcl_hulls.find(shape.geometry);
    return at != fcl_hulls.end()
               ? at->second
               : fcl_hulls.emplace(shape.geometry, FclHull(shape.geometry->hull)).first->second;
  }
  // True if FCL's answer was taken. `own`: the rows that were found, null for none.
  bool penetration_of(const RigidShape& s0, const RigidShape& s1, const geometry::Manifold* own,
                      geometry::Manifold& kept) {
    using namespace geometry;
    const Shape a = convex_shape(s0), b = convex_shape(s1);
    const Transformf relative = relative_pose(s0.pose, s1.pose);
    const ShapePair pair = shape_pair(a, b, relative);
    if (!is_finite(pair)) return false;
    float deepest = 0.0f;
    for (int32_t i = 0; own != nullptr && i < own->count; ++i)
      deepest = math::min(deepest, own->points[i].distance);
    const auto found = fcl_hull(s0).penetration(fcl_hull(s1), relative);
    if (!found && deepest >= 0.0f) return false;  // apart, for both
    ++fcl_pairs;
    constexpr float kTolerance = 1e-4f;  // of the size
    const auto size = [](const RigidShape& s) {
      return math::length(s.geometry->box.hi - s.geometry->box.lo);
    };
    const float tolerance = kTolerance * (size(s0) + size(s1));
    const float depth = found ? static_cast<float>(found->depth) : 0.0f;
    const Vec3f n = found ? found->normal : Vec3f{};
    // Written so that a NaN is refused.
    const bool good = found && math::abs(math::length(n) - 1.0f) <= 1e-3f &&
                      math::abs(separation_along(pair, n) + depth) <= tolerance &&
                      math::abs(depth + deepest) <= tolerance;
    if (!good) {
      ++fcl_fallbacks;
      return false;
    }
    const Vec3f on_b = support_point(pair, n).b;
    const Proximity proximity{n, -depth, on_b + n * depth, on_b};
    keep_rows(s0, s1, in_frame(clip_manifold(pair, proximity, reach_of(s0, s1)), s0.pose),
              contacts_per_pair, kept);
    return true;
  }

  // Behind the scan, on the CPU.
  int64_t rows_found() const {
    const Unobserved unobserved;
    const int64_t last = pair_count - 1;
    NOVAPHY_ASSERT(std::is_sorted(before.data(), before.data() + pair_count));
    return int64_t{before.data()[last]} + counts.data()[last];
  }
  // Leaves out the rows that are farthest apart where there are more than `capacity`.
  void limit_rows(const Array& moved, const Array& found, int64_t capacity) {
    const Device device = model->device();
    if (!limit) {
      limit_sums = DeviceArray<int32_t>(kLimitSums * kLimitParts, device);
      limit = Storage::allocate(sizeof(RigidContactLimit), device);
    }
    if (farther.rows() != counts.rows())
      for (DeviceArray<int32_t>* of_pairs : {&farther, &farther_before})
        *of_pairs = DeviceArray<int32_t>(counts.rows(), device);
    const Array to(DType::uint8, limit->bytes(), 1, limit->range());
    kernels().limit_sum.launch(
        device, kLimitSums,
        {reads("pairs", pairs), reads("shapes", moved), reads("manifolds", found),
         reads("counts", counts), reads("before", before), number(pair_count), number(capacity),
         writes("limit_sums", limit_sums)});
    const Array meshes =
        mesh_rows ? Array(DType::uint8, mesh_rows->bytes(), 1, mesh_rows->range()) : Array();
    if (mesh_pair_count > 0)
      kernels().limit_sum_mesh.launch(
          device, kLimitSums,
          {reads("mesh_pairs", mesh_pairs), reads("pairs", pairs), reads("shapes", moved),
           reads("mesh_rows", meshes), number(mesh_pair_count), updates("limit_sums", limit_sums)});
    kernels().limit.launch(
        device, 1,
        {reads("counts", counts), reads("before", before), reads("limit_sums", limit_sums),
         number(pair_count), number(capacity), number(kLimitSums), writes("limit", to)});
    kernels().farther.launch(
        device, pair_count,
        {reads("limit", to), reads_row("pairs", pairs), reads("shapes", moved),
         reads("manifolds", found), reads_row("counts", counts), writes_row("farther", farther)});
    if (mesh_pair_count > 0)
      kernels().farther_mesh.launch(
          device, mesh_pair_count,
          {reads("limit", to), reads_row("mesh_pairs", mesh_pairs), reads("pairs", pairs),
           reads("shapes", moved), reads("mesh_rows", meshes), updates("farther", farther)});
    kernels().scan.launch(device, pair_count,
                          {reads("counts", farther), writes("before", farther_before)});
    kernels().trim.launch(device, pair_count,
                          {reads("limit", to), reads_row("pairs", pairs), reads("shapes", moved),
                           reads_row("farther", farther_before), updates("manifolds", found),
                           updates("counts", counts)});
    if (mesh_pair_count > 0)
      kernels().trim_mesh.launch(
          device, mesh_pair_count,
          {reads("limit", to), reads_row("mesh_pairs", mesh_pairs), reads("pairs", pairs),
           reads("shapes", moved), reads("farther", farther_before), updates("mesh_rows", meshes),
           updates("counts", counts)});
  }

  void take_mesh_pairs(const std::vector<Vec2i>& found) {
    std::vector<int32_t> rows;
    const auto type_of = [&](int32_t s) {
      return static_cast<GeoType>(type[static_cast<size_t>(s)]);
    };
    for (size_t k = 0; k < found.size(); ++k)
      if (is_mesh_pair(type_of(found[k].x), type_of(found[k].y)))
        rows.push_back(static_cast<int32_t>(k));
    mesh_pair_count = static_cast<int64_t>(rows.size());
    if (rows.size() > mesh_pairs.rows()) {
      mesh_pairs = DeviceArray<int32_t>(rows.size(), model->device());
      mesh_rows = Storage::allocate(rows.size() * sizeof(MeshRows), model->device());
      if (!model->device().is_cpu())
        mesh_scratch = Storage::allocate(rows.size() * sizeof(MeshContacts), model->device());
    }
    rows.resize(mesh_pairs.rows());
    mesh_pairs.copy_from_host(std::span<const int32_t>(rows));
  }

  void find_candidates() {
    geometries->update();
    if (versions.match(choosing())) return;
    versions.reset();
    const Model& m = *model;
    body = m.shape_body.to_host();
    for (size_t s = 0; s < body.size(); ++s)
      require(body[s] >= -1 && body[s] < m.body_count(), ErrorKind::Index,
              "CollisionPipeline: model.shape_body[", s, "]: expected -1 to ", m.body_count() - 1,
              ", got ", body[s]);
    type = m.shape_type.to_host();
    flags = m.shape_flags.to_host();
    group = m.shape_collision_group.to_host();
    world = m.shape_world.to_host();
    scale = m.shape_scale.to_host();
    shapes = Storage::allocate(body.size() * sizeof(RigidShape), m.device());
    kernel_sweep_known = false;
    if (broad_phase == BroadPhase::Sap) {
      most_rows = std::numeric_limits<int64_t>::max();
      if (!m.device().is_cpu()) check_all_pairs();
    } else {
      pairs = {};
      most_rows = take(explicit_pairs ? *explicit_pairs
                       : broad_phase == BroadPhase::Explicit
                           ? m.shape_contact_pairs.to_host()
                           : make_shape_contact_pairs(body, flags, group, world,
                                                      m.shape_collision_filter_pairs));
    }
    versions.set(choosing());
  }
  // What kernels that find pairs cannot refuse.
  void check_all_pairs() const {
    const ShapePairRules rule = rules();
    const auto count = static_cast<int32_t>(type.size());
    for (int32_t s = 0; s < count; ++s) {
      const auto shape_type = static_cast<GeoType>(type[static_cast<size_t>(s)]);
      if (geometry::is_convex_type(shape_type)) continue;
      for (int32_t other = 0; other < count; ++other) {
        if (other == s || !may_touch(rule, s, other)) continue;
        Vec2i pair{std::min(s, other), std::max(s, other)};
        orient(pair);
        require(shape_type != GeoType::MESH, ErrorKind::NotImplemented,
                "CollisionPipeline: shapes ", pair.x, " and ", pair.y,
                " may meet: the broad phase \"sap\" finds pairs of meshes on the cpu only, and not "
                "where it is recorded; use \"explicit\" or \"nxn\"");
      }
    }
  }
  // The pairs of shapes that were moved to the world, by kernels: as many as there is room for.
  // Outside of a recording there is room for all.
  void sweep_by_kernels(const Array& moved) {
    if (!kernel_sweep_known) {
      const Unobserved unobserved;  // the model is no part of what a capture records
      check_all_pairs();
      kernel_sweep.update(*model, world);
      kernel_sweep_known = true;
    }
    const auto shapes_count = static_cast<int64_t>(type.size());
    constexpr int64_t kFew = 1024, kPerShape = 16;
    make_room(static_cast<size_t>(
        std::max<int64_t>(1, std::min(shapes_count * (shapes_count - 1) / 2,
                                      std::max(kFew, kPerShape * shapes_count)))));
    kernel_sweep.sort(*model, moved);
    kernel_sweep.write(*model, moved, pairs);
    if (launch_recorder() == nullptr) {
      const auto found = static_cast<size_t>(kernel_sweep.found().to_host()[0]);
      if (found > pairs.rows()) {
        make_room(found + found / 4);
        kernel_sweep.write(*model, moved, pairs);
      }
    }
    pair_count = static_cast<int64_t>(pairs.rows());
    mesh_pair_count = 0;
  }
  // The pairs whose boxes meet now, of shapes that were moved to the world.
  void sweep_shapes() {
    const auto* const moved = static_cast<const RigidShape*>(shapes->range()->data());
    boxes.resize(body.size());
    for (size_t s = 0; s < boxes.size(); ++s) boxes[s] = moved[s].box;
    take(sweep.box_pairs(boxes, rules()));
  }
};

RigidContacts::RigidContacts(std::shared_ptr<const Model> model,
                             std::shared_ptr<ShapeGeometries> geometries, BroadPhase broad_phase,
                             NarrowPhase narrow_phase, int32_t contacts_per_pair,
                             std::optional<std::vector<Vec2i>> explicit_pairs)
    : impl_(std::make_unique<Impl>()) {
  impl_->model = std::move(model);
  impl_->geometries = std::move(geometries);
  impl_->broad_phase = broad_phase;
  impl_->narrow_phase = narrow_phase;
  impl_->contacts_per_pair = contacts_per_pair;
  impl_->explicit_pairs = std::move(explicit_pairs);
}
RigidContacts::~RigidContacts() = default;

int64_t RigidContacts::fcl_pairs() const { return impl_->fcl_pairs; }
int64_t RigidContacts::fcl_fallbacks() const { return impl_->fcl_fallbacks; }

int64_t RigidContacts::most_rows() {
  impl_->find_candidates();
  return impl_->most_rows;
}

void RigidContacts::collide(const SimState& state, Contacts& c, float dt) {
  const Model& m = *impl_->model;
  const Device device = m.device();
  impl_->find_candidates();
  depend_on(impl_->choosing());  // which the host has read
  const bool sweeps = impl_->broad_phase == BroadPhase::Sap;
  // On the CPU the host is faster: it keeps the order of the last call.
  const bool by_kernels = sweeps && (!device.is_cpu() || launch_recorder() != nullptr);
  const bool asks_fcl = impl_->narrow_phase == NarrowPhase::Fcl;
  require(!asks_fcl || launch_recorder() == nullptr, ErrorKind::Runtime,
          "collide: the narrow phase \"fcl\" asks on the host, so it cannot be recorded; use "
          "\"auto\"");
  const int64_t rows = c.rigid_contact_max();
  // Nothing to find and nowhere to write: a model without bodies needs no kernel on its device.
  if (!sweeps && impl_->pair_count == 0 && rows == 0) return;
  // What a row holds carries no gradient, so nothing that the search reads needs one.
  const auto constant = [](const char* name, const Array& array) {
    return reads(name, array).detached();
  };
  const auto bytes = [](const std::shared_ptr<Storage>& storage) {
    return Array(DType::uint8, storage->bytes(), 1, storage->range());
  };
  const Array shapes = bytes(impl_->shapes), geometries = impl_->geometries->tables();
  // The arguments, then those of RigidContactRows.
  const auto with_rows = [&](auto... arguments) {
    return std::array{arguments...,
                      number(rows),
                      writes("rigid_contact_shape0", c.rigid_contact_shape0),
                      writes("rigid_contact_shape1", c.rigid_contact_shape1),
                      writes("rigid_contact_point0", c.rigid_contact_point0),
                      writes("rigid_contact_point1", c.rigid_contact_point1),
                      writes("rigid_contact_offset0", c.rigid_contact_offset0),
                      writes("rigid_contact_offset1", c.rigid_contact_offset1),
                      writes("rigid_contact_normal", c.rigid_contact_normal),
                      writes("rigid_contact_margin0", c.rigid_contact_margin0),
                      writes("rigid_contact_margin1", c.rigid_contact_margin1),
                      writes("rigid_contact_point_id", c.rigid_contact_point_id)};
  };
  // Where the host waits for the rows, those behind the last one need no second look.
  const bool waits = device.is_cpu() && launch_recorder() == nullptr;
  const bool knows_empty = waits && impl_->emptied.matches(c.rigid_contact_shape0);
  if (sweeps || impl_->pair_count > 0) {
    kernels().shape.launch(
        device, m.shape_count(),
        {reads_row("shape_body", m.shape_body), reads_row("shape_type", m.shape_type),
         constant("shape_scale", m.shape_scale), constant("shape_transform", m.shape_transform),
         constant("shape_margin", m.shape_margin), constant("shape_gap", m.shape_gap),
         constant("body_q", state.body_q), constant("body_qd", state.body_qd),
         constant("body_com", m.body_com), constant("shape_material_ka", m.shape_material_ka),
         number(dt), reads_row("geometry", impl_->geometries->of_shape()),
         reads("views", geometries), writes("shapes", shapes)});
  }
  if (by_kernels)
    impl_->sweep_by_kernels(shapes);
  else if (sweeps)
    impl_->sweep_shapes();
  const int64_t pairs = impl_->pair_count, mesh_pairs = impl_->mesh_pair_count;
  if (pairs > 0) {
    const Array manifolds = bytes(impl_->manifolds);
    const LaunchArgument found =
        reads("pairs_found", by_kernels ? impl_->kernel_sweep.found() : DeviceArray<int32_t>());
    kernels().find.launch(device, pairs,
                          {found, reads_row("pairs", impl_->pairs), reads("shapes", shapes),
                           number(int64_t{impl_->contacts_per_pair}),
                           writes("manifolds", manifolds), writes_row("counts", impl_->counts)});
    if (mesh_pairs > 0)
      kernels().find_mesh.launch(
          device, mesh_pairs,
          {reads_row("mesh_pairs", impl_->mesh_pairs), reads("pairs", impl_->pairs),
           reads("shapes", shapes),
           writes("scratch", impl_->mesh_scratch ? bytes(impl_->mesh_scratch) : Array()),
           writes("mesh_rows", bytes(impl_->mesh_rows)), updates("counts", impl_->counts)});
    if (asks_fcl) impl_->ask_fcl();
    const auto scan = [&] {
      kernels().scan.launch(device, pairs,
                            {reads("counts", impl_->counts), writes("before", impl_->before)});
    };
    scan();
    // Where the host does not wait, kernels see whether there is room.
    const bool limits = waits ? impl_->rows_found() > rows : rows < impl_->most_rows;
    LaunchArgument limit = reads("limit", Array());
    if (limits) {
      impl_->limit_rows(shapes, manifolds, rows);
      scan();
      limit = reads("limit", bytes(impl_->limit));
    }
    kernels().write.launch(
        device, pairs,
        with_rows(limit, found, reads_row("pairs", impl_->pairs), reads("shapes", shapes),
                  reads("manifolds", manifolds), reads_row("counts", impl_->counts),
                  reads_row("before", impl_->before),
                  writes("rigid_contact_count", c.rigid_contact_count)));
    if (mesh_pairs > 0)
      kernels().write_mesh.launch(
          device, mesh_pairs,
          with_rows(reads_row("mesh_pairs", impl_->mesh_pairs), reads("pairs", impl_->pairs),
                    reads("shapes", shapes), reads("mesh_rows", bytes(impl_->mesh_rows)),
                    reads("before", impl_->before)));
  }
  int64_t used = rows;
  if (waits) {
    const Unobserved unobserved;
    used = pairs > 0 ? std::min<int64_t>(rows, *c.rigid_contact_count.data()) : 0;
  }
  const int64_t last = knows_empty ? std::max(used, impl_->used) : rows;
  kernels().clear.launch(device, last + 1,
                         {number(pairs), updates("rigid_contact_count", c.rigid_contact_count),
                          updates("rigid_contact_shape0", c.rigid_contact_shape0),
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
  impl_->emptied.reset();
  if (waits) impl_->emptied.set(c.rigid_contact_shape0);
  impl_->used = used;
}

}  // namespace novaphy::detail
