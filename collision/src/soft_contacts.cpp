#include "soft_contacts.h"

#include <array>
#include <vector>

#include "array_versions.h"
#include "byte_array.h"
#include "novaphy/collision/candidate_pairs.h"
#include "novaphy/core/builtin_kernels.h"
#include "novaphy/core/error.h"
#include "soft_contact_kernels.h"

namespace novaphy::detail {
namespace {

// Never destroyed, because recordings refer to the kernels.
struct Kernels {
  Kernel<SoftContactShapeArguments> shape{soft_contact_shape, soft_contact_kernels_source};
  Kernel<SoftContactTouchArguments> touch{soft_contact_touch, soft_contact_kernels_source};
  Kernel<SoftContactWriteArguments> write{soft_contact_write, soft_contact_kernels_source};
  Kernel<SoftContactNoneArguments> none{soft_contact_none, soft_contact_kernels_source};
  Kernel<SoftContactClearArguments> clear{soft_contact_clear, soft_contact_kernels_source};
  Kernel<ContactGenerationArguments> generation{contact_generation, soft_contact_kernels_source};
};
const Kernels& kernels() {
  static const auto& all = *new Kernels;
  return all;
}

void check_covered_shape(int32_t index, int32_t body, int32_t bodies, GeoType type) {
  require(body >= -1 && body < bodies, ErrorKind::Index, "CollisionPipeline: model.shape_body[",
          index, "]: expected -1 to ", bodies - 1, ", got ", body);
  const bool covered = shape_traits(type).size != ShapeSize::NONE;
  require(covered, ErrorKind::NotImplemented, "CollisionPipeline: shape ", index, " has type ",
          geo_type_name(type), " (", static_cast<int32_t>(type),
          "); particles meet only PLANE, BOX, SPHERE, CAPSULE, CYLINDER, CONE, ELLIPSOID, MESH and "
          "CONVEX_MESH (ShapeConfig.has_particle_collision)");
}

}  // namespace

struct SoftContacts::Impl {
  std::shared_ptr<const Model> model;
  std::shared_ptr<ShapeGeometries> geometries;
  // The candidate shapes and pairs, and the versions of the arrays from which they were made.
  ArrayVersions<5> versions;
  DeviceArray<int32_t> candidates;
  DeviceArray<int32_t> pair_particle, pair_shape;  // candidate_pairs.h
  // Scratch memory, reused between calls.
  Array shapes;                 // a SoftContactShape for each shape
  DeviceArray<int32_t> before;  // slots before each pair

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
    std::vector<int32_t> found;  // shapes of the pairs, which are sorted by shape
    for (const int32_t s : pairs.shape) {
      if (!found.empty() && found.back() == s) continue;
      check_covered_shape(s, body[static_cast<size_t>(s)], model->body_count(),
                          static_cast<GeoType>(type[static_cast<size_t>(s)]));
      found.push_back(s);
    }
    candidates = DeviceArray<int32_t>::from_host(found, model->device());
    pair_particle = DeviceArray<int32_t>::from_host(pairs.particle, model->device());
    pair_shape = DeviceArray<int32_t>::from_host(pairs.shape, model->device());
    shapes = byte_array<SoftContactShape>(body.size(), model->device());
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
  depend_on(impl_->choosing());  // the host has read these arrays
  const int64_t pairs = contacts.soft_contact_pair_count(), slots = contacts.soft_contact_max();
  const auto shape_count = static_cast<int64_t>(impl_->candidates.rows());
  const Array& shapes = impl_->shapes;
  if (impl_->before.rows() < static_cast<size_t>(pairs))
    impl_->before = DeviceArray<int32_t>(static_cast<size_t>(pairs), device);
  const Array& views = impl_->geometries->tables();
  if (pairs > 0) {
    run(kernels().shape, shape_count,
        {.candidates = impl_->candidates,
         .body = m.shape_body,
         .body_q = state.body_q,
         .type = m.shape_type,
         .scale = m.shape_scale,
         .xform = m.shape_transform,
         .margin = m.shape_margin,
         .gap = gap,
         .geometry = impl_->geometries->of_shape(),
         .views = Untyped(views),
         .shapes = Untyped(shapes)});
    run(kernels().touch, pairs,
        {.pair_particle = impl_->pair_particle,
         .pair_shape = impl_->pair_shape,
         .shapes = Untyped(shapes),
         .q = state.particle_q,
         .radius = m.particle_radius,
         .flags = m.particle_flags,
         .touches = contacts.soft_contact_tids});
    run(exclusive_scan(), pairs, {.in = contacts.soft_contact_tids, .out = impl_->before});
    run(kernels().write, pairs,
        {.pair_particle = impl_->pair_particle,
         .pair_shape = impl_->pair_shape,
         .shapes = Untyped(shapes),
         .q = state.particle_q,
         .radius = m.particle_radius,
         .before = impl_->before,
         .slots = slots,
         .tids = contacts.soft_contact_tids,
         .count = contacts.soft_contact_count,
         .particle = contacts.soft_contact_particle,
         .shape = contacts.soft_contact_shape,
         .body_pos = contacts.soft_contact_body_pos,
         .body_vel = contacts.soft_contact_body_vel,
         .normal = contacts.soft_contact_normal});
  } else {
    run(kernels().none, 1, {.count = contacts.soft_contact_count});
  }
  run(kernels().clear, slots,
      {.count = contacts.soft_contact_count,
       .particle = contacts.soft_contact_particle,
       .shape = contacts.soft_contact_shape,
       .body_pos = contacts.soft_contact_body_pos,
       .body_vel = contacts.soft_contact_body_vel,
       .normal = contacts.soft_contact_normal});
  run(kernels().generation, 1, {.generation = contacts.contact_generation});
}

}  // namespace novaphy::detail
