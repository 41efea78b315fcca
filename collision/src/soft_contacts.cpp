#include "soft_contacts.h"

#include <array>
#include <vector>

#include "array_versions.h"
#include "novaphy/collision/candidate_pairs.h"
#include "novaphy/core/device_kernel.h"
#include "novaphy/core/error.h"
#include "soft_contact_kernels.h"

namespace novaphy::detail {
namespace {

// Never destroyed: recordings refer to them.
struct Kernels {
  DeviceKernel shape{soft_contact_shape, soft_contact_kernels_text};
  DeviceKernel touch{soft_contact_touch, soft_contact_kernels_text};
  DeviceKernel scan{"exclusive_scan_i32"};
  DeviceKernel write{soft_contact_write, soft_contact_kernels_text};
  DeviceKernel none{soft_contact_none, soft_contact_kernels_text};
  DeviceKernel clear{soft_contact_clear, soft_contact_kernels_text};
  DeviceKernel generation{contact_generation, soft_contact_kernels_text};
};
const Kernels& kernels() {
  static const auto& all = *new Kernels;
  return all;
}

void check_covered_shape(int32_t index, int32_t body, int32_t bodies, GeoType type) {
  require(body >= -1 && body < bodies, ErrorKind::Index, "CollisionPipeline: model.shape_body[",
          index, "]: expected -1 to ", bodies - 1, ", got ", body);
  const bool covered = type == GeoType::PLANE || type == GeoType::BOX || type == GeoType::SPHERE ||
                       type == GeoType::CAPSULE || type == GeoType::CYLINDER ||
                       type == GeoType::CONE || type == GeoType::ELLIPSOID ||
                       type == GeoType::MESH || type == GeoType::CONVEX_MESH;
  require(covered, ErrorKind::NotImplemented, "CollisionPipeline: shape ", index, " has type ",
          geo_type_name(type), " (", static_cast<int32_t>(type),
          "); particles meet only PLANE, BOX, SPHERE, CAPSULE, CYLINDER, CONE, ELLIPSOID, MESH and "
          "CONVEX_MESH (ShapeConfig.has_particle_collision)");
}

}  // namespace

struct SoftContacts::Impl {
  std::shared_ptr<const Model> model;
  std::shared_ptr<ShapeGeometries> geometries;
  // Which shapes may be met and by whom, and the versions of the arrays that say so.
  ArrayVersions<5> versions;
  DeviceArray<int32_t> candidates;
  DeviceArray<int32_t> pair_particle, pair_shape;  // candidate_pairs.h
  // Scratch, kept from call to call.
  std::shared_ptr<Storage> shapes;  // a SoftContactShape per shape
  DeviceArray<int32_t> before;      // the slots before each pair

  std::array<const Array*, 5> choosing() const {
    return {&model->shape_flags, &model->shape_body, &model->shape_type, &model->shape_world,
            &model->particle_world};
  }
  void find_candidates() {
    geometries->update();
    if (versions.match(choosing())) return;
    const std::vector<int32_t> body = model->shape_body.to_host(),
                               type = model->shape_type.to_host();
    const CandidatePairs pairs = make_candidate_pairs(*model);
    std::vector<int32_t> found;  // the shapes of the pairs, which are shape-major
    for (const int32_t s : pairs.shape) {
      if (!found.empty() && found.back() == s) continue;
      check_covered_shape(s, body[static_cast<size_t>(s)], model->body_count(),
                          static_cast<GeoType>(type[static_cast<size_t>(s)]));
      found.push_back(s);
    }
    candidates = DeviceArray<int32_t>::from_host(found, model->device());
    pair_particle = DeviceArray<int32_t>::from_host(pairs.particle, model->device());
    pair_shape = DeviceArray<int32_t>::from_host(pairs.shape, model->device());
    shapes = Storage::allocate(body.size() * sizeof(SoftContactShape), model->device());
    versions.set(choosing());
  }
};

SoftContacts::SoftContacts(std::shared_ptr<const Model> model,
                           std::shared_ptr<ShapeGeometries> geometries)
    : impl_(std::make_unique<Impl>()) {
  impl_->model = std::move(model);
  impl_->geometries = std::move(geometries);
}
SoftContacts::~SoftContacts() = default;

int32_t SoftContacts::pair_count() {
  impl_->find_candidates();
  return static_cast<int32_t>(impl_->pair_shape.rows());
}

void SoftContacts::collide(const SimState& state, Contacts& contacts, float gap) {
  const Model& m = *impl_->model;
  const Device device = m.device();
  impl_->find_candidates();
  depend_on(impl_->choosing());  // which the host has read
  const int64_t pairs = contacts.soft_contact_pair_count(), slots = contacts.soft_contact_max();
  const auto shape_count = static_cast<int64_t>(impl_->candidates.rows());
  const Array shapes(DType::uint8, impl_->shapes->bytes(), 1, impl_->shapes->range());
  if (impl_->before.rows() < static_cast<size_t>(pairs))
    impl_->before = DeviceArray<int32_t>(static_cast<size_t>(pairs), device);
  // What a record holds carries no gradient, so nothing that the search reads needs one.
  const auto constant = [](const char* name, const Array& array) {
    return reads(name, array).detached();
  };
  if (pairs > 0) {
    kernels().shape.launch(
        device, shape_count,
        {reads_row("candidates", impl_->candidates), reads("shape_body", m.shape_body),
         constant("body_q", state.body_q), reads("shape_type", m.shape_type),
         constant("shape_scale", m.shape_scale), constant("shape_transform", m.shape_transform),
         constant("shape_margin", m.shape_margin), number(gap),
         reads("geometry", impl_->geometries->of_shape()),
         reads("views", impl_->geometries->tables()), writes("shapes", shapes)});
    kernels().touch.launch(
        device, pairs,
        {reads_row("pair_particle", impl_->pair_particle),
         reads_row("pair_shape", impl_->pair_shape), reads("shapes", shapes),
         constant("particle_q", state.particle_q), constant("particle_radius", m.particle_radius),
         reads("particle_flags", m.particle_flags),
         writes_row("soft_contact_tids", contacts.soft_contact_tids)});
    kernels().scan.launch(
        device, pairs,
        {reads("soft_contact_tids", contacts.soft_contact_tids), writes("before", impl_->before)});
    kernels().write.launch(
        device, pairs,
        {reads_row("pair_particle", impl_->pair_particle),
         reads_row("pair_shape", impl_->pair_shape), reads("shapes", shapes),
         constant("particle_q", state.particle_q), constant("particle_radius", m.particle_radius),
         reads_row("before", impl_->before), number(slots),
         updates_row("soft_contact_tids", contacts.soft_contact_tids),
         writes("soft_contact_count", contacts.soft_contact_count),
         writes("soft_contact_particle", contacts.soft_contact_particle),
         writes("soft_contact_shape", contacts.soft_contact_shape),
         writes("soft_contact_body_pos", contacts.soft_contact_body_pos),
         writes("soft_contact_body_vel", contacts.soft_contact_body_vel),
         writes("soft_contact_normal", contacts.soft_contact_normal)});
  }
  if (pairs == 0)
    kernels().none.launch(device, 1, {writes("soft_contact_count", contacts.soft_contact_count)});
  kernels().clear.launch(device, slots,
                         {reads("soft_contact_count", contacts.soft_contact_count),
                          writes("soft_contact_particle", contacts.soft_contact_particle),
                          writes("soft_contact_shape", contacts.soft_contact_shape),
                          writes("soft_contact_body_pos", contacts.soft_contact_body_pos),
                          writes("soft_contact_body_vel", contacts.soft_contact_body_vel),
                          writes("soft_contact_normal", contacts.soft_contact_normal)});
  kernels().generation.launch(device, 1,
                              {updates_row("contact_generation", contacts.contact_generation)});
}

}  // namespace novaphy::detail
