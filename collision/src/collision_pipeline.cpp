#include "novaphy/collision/collision_pipeline.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "device_soft_contacts.h"
#include "novaphy/collision/diff_soft_contact_trace.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/for_chunks.h"

namespace novaphy {
namespace {

constexpr int64_t kChunk = 2048;  // candidate pairs, or shapes

// What the search needs of a shape that particles may meet.
struct CandidateShape {
  int32_t index = -1;
  GeoType type = GeoType::NONE;
  int32_t world = -1;
  float reach = 0.0f;  // gap + margin
  Vec3f scale;
  Transformf xform, pose, to_local;
  Vec3f
      velocity;  // of the surface in the body's frame: zero, with the signs that rotating it gives
};

SurfaceDistance<float> surface_distance(const CandidateShape& shape, const Vec3f& x) {
  switch (shape.type) {
    case GeoType::BOX:
      return box_distance(x, shape.scale);
    case GeoType::SPHERE:
      return sphere_distance(x, shape.scale.x);
    case GeoType::CAPSULE:
      return capsule_distance(x, shape.scale.x, shape.scale.y);
    default:
      return plane_distance(x, shape.scale.x, shape.scale.y);
  }
}

}  // namespace

void detail::check_covered_shape(int32_t index, int32_t body, GeoType type) {
  require(body < 0, ErrorKind::NotImplemented, "CollisionPipeline: shape ", index,
          " is owned by body ", body, "; only world-owned shapes (body -1) are there yet");
  const bool covered = type == GeoType::PLANE || type == GeoType::BOX || type == GeoType::SPHERE ||
                       type == GeoType::CAPSULE;
  require(covered, ErrorKind::NotImplemented, "CollisionPipeline: shape ", index, " has type ",
          geo_type_name(type), " (", static_cast<int32_t>(type),
          "); only PLANE, BOX, SPHERE and CAPSULE are there yet");
}

namespace {

int32_t count_candidate_shapes(const Model& model) {
  const int32_t* flags = model.shape_flags.data();
  int32_t count = 0;
  for (int32_t s = 0; s < model.shape_count(); ++s) {
    if (!has_flag(flags[s], ShapeFlags::COLLIDE_PARTICLES)) continue;
    detail::check_covered_shape(s, model.shape_body.data()[s],
                                static_cast<GeoType>(model.shape_type.data()[s]));
    ++count;
  }
  return count;
}

std::vector<CandidateShape> candidate_shapes(const Model& model, float gap) {
  std::vector<CandidateShape> shapes;
  shapes.reserve(static_cast<size_t>(model.shape_count()));
  for (int32_t s = 0; s < model.shape_count(); ++s) {
    if (!has_flag(model.shape_flags.data()[s], ShapeFlags::COLLIDE_PARTICLES)) continue;
    const auto type = static_cast<GeoType>(model.shape_type.data()[s]);
    detail::check_covered_shape(s, model.shape_body.data()[s], type);
    CandidateShape& shape = shapes.emplace_back();
    shape.index = s;
    shape.type = type;
    shape.world = model.shape_world.data()[s];
    shape.scale = model.shape_scale.data()[s];
    shape.xform = model.shape_transform.data()[s];
  }
  // Arithmetic runs in chunks only: they round to nearest whatever mode the caller has set.
  for_chunks(static_cast<int64_t>(shapes.size()), kChunk, [&](int64_t begin, int64_t end, int64_t) {
    for (int64_t i = begin; i < end; ++i) {
      CandidateShape& shape = shapes[static_cast<size_t>(i)];
      shape.reach = gap + model.shape_margin.data()[shape.index];
      shape.pose = static_shape_pose(shape.xform);
      shape.to_local = math::inverse(shape.pose);
      shape.velocity = math::rotate(shape.xform.q, Vec3f{});
    }
  });
  return shapes;
}

void check_margin(const char* what, float margin) {
  require(std::isfinite(margin) && margin >= 0.0f, ErrorKind::Value, what,
          ": soft_contact_margin: expected a finite number >= 0, got ", margin);
}

// The search over the pairs of one collide.
struct Search {
  const Model& model;
  const std::vector<CandidateShape>& shapes;
  int64_t particles;
  const Vec3f* q;
  const float* radius;
  const int32_t* flags;
  const int32_t* world;

  bool touches(const CandidateShape& shape, int64_t p) const {
    if (!has_flag(flags[p], ParticleFlags::ACTIVE)) return false;
    if (world[p] != shape.world && world[p] >= 0 && shape.world >= 0) return false;
    const Vec3f x = math::transform_point(shape.to_local, q[p]);
    return surface_distance(shape, x).distance < shape.reach + radius[p];
  }

  // Calls body(shape, particle, pair) for the pairs [begin, end).
  template <class Body>
  void for_pairs(int64_t begin, int64_t end, Body&& body) const {
    int64_t p = begin % particles;
    const CandidateShape* shape = shapes.data() + begin / particles;
    for (int64_t pair = begin; pair < end; ++pair) {
      body(*shape, p, pair);
      if (++p == particles) {
        p = 0;
        ++shape;
      }
    }
  }
};

}  // namespace

CollisionPipeline::CollisionPipeline(std::shared_ptr<const Model> model,
                                     const CollisionOptions& options)
    : model_(std::move(model)), options_(options) {
  constexpr const char* name = "CollisionPipeline";
  require(model_ != nullptr, ErrorKind::Value, name, ": model: expected a model, got null");
#ifdef NOVAPHY_WITH_DEVICE_COLLISION
  if (!model_->device().is_cpu()) device_ = std::make_shared<detail::DeviceSoftContacts>(model_);
#else
  require(model_->device().is_cpu(), ErrorKind::NotImplemented, name,
          ": expected a model on the cpu, got one on ", model_->device().str(),
          "; this build has no collision for other devices (NOVAPHY_WITH_COLLISION_CUDA)");
#endif
  require(options.broad_phase != BroadPhase::Sap, ErrorKind::NotImplemented, name,
          ": broad_phase: sweep and prune (\"sap\") is not there yet; use \"explicit\" or \"nxn\"");
  require(options.broad_phase == BroadPhase::Explicit || options.broad_phase == BroadPhase::NxN,
          ErrorKind::Value, name, ": broad_phase: expected a BroadPhase, got ",
          static_cast<int>(options.broad_phase));
  check_margin(name, options.soft_contact_margin);
  const int32_t soft_max = options.soft_contact_max.value_or(0);
  require(soft_max >= 0, ErrorKind::Value, name, ": soft_contact_max: expected >= 0, got ",
          soft_max);
  const int32_t rigid_max = options.rigid_contact_max.value_or(0);
  require(rigid_max >= 0, ErrorKind::Value, name, ": rigid_contact_max: expected >= 0, got ",
          rigid_max);
  require(rigid_max == 0, ErrorKind::NotImplemented, name,
          ": rigid_contact_max: expected 0 (rigid contacts are not there yet), got ", rigid_max);
  soft_contact_pair_count();
}

int32_t CollisionPipeline::soft_contact_pair_count() const {
#ifdef NOVAPHY_WITH_DEVICE_COLLISION
  const int32_t shapes = device_ ? device_->candidate_count() : count_candidate_shapes(*model_);
#else
  const int32_t shapes = count_candidate_shapes(*model_);
#endif
  const int64_t pairs = int64_t{model_->particle_count()} * shapes;
  require(pairs <= std::numeric_limits<int32_t>::max(), ErrorKind::Value,
          "CollisionPipeline: expected at most ", std::numeric_limits<int32_t>::max(),
          " candidate pairs, got ", pairs, " (", model_->particle_count(), " particles)");
  return static_cast<int32_t>(pairs);
}

int32_t CollisionPipeline::soft_contact_max() const {
  return options_.soft_contact_max ? *options_.soft_contact_max : soft_contact_pair_count();
}

Contacts CollisionPipeline::contacts() const {
  return Contacts({.soft_contact_max = soft_contact_max(),
                   .soft_contact_pair_count = soft_contact_pair_count(),
                   .model_id = model_->id(),
                   .requires_grad = options_.requires_grad.value_or(model_->requires_grad)},
                  model_->device());
}

void CollisionPipeline::collide(const SimState& state, Contacts& contacts,
                                std::optional<float> soft_contact_margin) {
  constexpr const char* name = "collide";
  const float gap = soft_contact_margin.value_or(options_.soft_contact_margin);
  check_margin(name, gap);
  require(state.model_id() == model_->id(), ErrorKind::Value, name,
          ": state: expected a state of the pipeline's model, got one of another model");
  require(contacts.model_id() == model_->id(), ErrorKind::Value, name,
          ": contacts: expected contacts of the pipeline's model, got others; use "
          "CollisionPipeline.contacts()");
  const int64_t particles = model_->particle_count();
  require(static_cast<int64_t>(state.particle_q.rows()) == particles &&
              state.particle_q.device() == model_->device(),
          ErrorKind::Value, name, ": state.particle_q: expected ", particles, " rows on ",
          model_->device().str(), ", got ", state.particle_q.rows(), " rows on ",
          state.particle_q.device().str());
  const int64_t pairs = soft_contact_pair_count();
  require(pairs == contacts.soft_contact_pair_count(), ErrorKind::Value, name,
          ": contacts: expected ", pairs, " candidate pairs, got ",
          contacts.soft_contact_pair_count(),
          "; the flags of shapes were edited, use CollisionPipeline.contacts() again");
  detail::check_fields(detail::const_fields<ContactFields>(contacts),
                       ContactFields::expected_rows(contacts.counts()), model_->device(),
                       "collide: contacts");
#ifdef NOVAPHY_WITH_DEVICE_COLLISION
  if (device_) return device_->collide(state, contacts, gap);
#endif
  const std::vector<CandidateShape> shapes = candidate_shapes(*model_, gap);

  const Search search = {*model_,
                         shapes,
                         particles,
                         state.particle_q.data(),
                         model_->particle_radius.data(),
                         model_->particle_flags.data(),
                         model_->particle_world.data()};
  int32_t* const tids = contacts.soft_contact_tids.mutable_data();
  int32_t* const out_particle = contacts.soft_contact_particle.mutable_data();
  int32_t* const out_shape = contacts.soft_contact_shape.mutable_data();
  Vec3f* const out_pos = contacts.soft_contact_body_pos.mutable_data();
  Vec3f* const out_vel = contacts.soft_contact_body_vel.mutable_data();
  Vec3f* const out_normal = contacts.soft_contact_normal.mutable_data();

  // First pass: which pairs touch, and how many in every chunk.
  const int64_t chunks = chunk_count(pairs, kChunk);
  chunk_offsets_.assign(static_cast<size_t>(chunks) + 1, 0);
  for_chunks(pairs, kChunk, [&](int64_t begin, int64_t end, int64_t chunk) {
    int64_t count = 0;
    search.for_pairs(begin, end, [&](const CandidateShape& shape, int64_t p, int64_t pair) {
      const bool touches = search.touches(shape, p);
      tids[pair] = touches ? 0 : -1;
      count += touches;
    });
    chunk_offsets_[static_cast<size_t>(chunk) + 1] = count;
  });
  for (size_t i = 1; i < chunk_offsets_.size(); ++i) chunk_offsets_[i] += chunk_offsets_[i - 1];
  const int64_t found = chunk_offsets_.back();
  const int64_t slots = contacts.soft_contact_max();

  // Second pass: every chunk writes its contacts to the slots that the counts give it.
  for_chunks(pairs, kChunk, [&](int64_t begin, int64_t end, int64_t chunk) {
    int64_t slot = chunk_offsets_[static_cast<size_t>(chunk)];
    if (slot == chunk_offsets_[static_cast<size_t>(chunk) + 1]) return;
    search.for_pairs(begin, end, [&](const CandidateShape& shape, int64_t p, int64_t pair) {
      if (tids[pair] < 0) return;
      if (slot >= slots) {
        tids[pair] = -1;
        return;
      }
      const Vec3f x = math::transform_point(shape.to_local, search.q[p]);
      const StaticContact<float> contact =
          static_contact_record(shape.xform, shape.pose, x, surface_distance(shape, x));
      tids[pair] = static_cast<int32_t>(slot);
      out_particle[slot] = static_cast<int32_t>(p);
      out_shape[slot] = shape.index;
      out_pos[slot] = contact.point;
      out_vel[slot] = shape.velocity;
      out_normal[slot] = contact.normal;
      ++slot;
    });
  });

  const int64_t used = std::min(found, slots);
  std::fill(out_particle + used, out_particle + slots, -1);
  std::fill(out_shape + used, out_shape + slots, -1);
  std::fill(out_pos + used, out_pos + slots, Vec3f{});
  std::fill(out_vel + used, out_vel + slots, Vec3f{});
  std::fill(out_normal + used, out_normal + slots, Vec3f{});
  *contacts.soft_contact_count.mutable_data() = static_cast<int32_t>(found);
  ++*contacts.contact_generation.mutable_data();
}

}  // namespace novaphy
