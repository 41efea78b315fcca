#include "novaphy/collision/collision_pipeline.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "fcl_penetration.h"
#include "novaphy/collision/overlaps.h"
#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/input_checks.h"
#include "novaphy/core/warning.h"
#include "rigid_contacts.h"
#include "soft_contacts.h"

namespace novaphy {
namespace {

void check_margin(const char* what, float margin) {
  require(std::isfinite(margin) && margin >= 0.0f, ErrorKind::Value, what,
          ": soft_contact_margin: expected a finite number >= 0, got ", margin);
}

// Sorts the pairs in ascending order, with the smaller shape first, and removes duplicates.
void order_pairs(std::vector<Vec2i>& pairs, const Model& model) {
  constexpr const char* name = "CollisionPipeline: shape_pairs_filtered";
  const std::vector<int32_t> body = model.shape_body.to_host();
  const auto less = [](const Vec2i& a, const Vec2i& b) {
    return a.x != b.x ? a.x < b.x : a.y < b.y;
  };
  for (size_t k = 0; k < pairs.size(); ++k) {
    Vec2i& pair = pairs[k];
    for (const int32_t shape : {pair.x, pair.y})
      require(shape >= 0 && shape < model.shape_count(), ErrorKind::Index, name, "[", k,
              "]: expected shapes from 0 to ", model.shape_count() - 1, ", got ", shape);
    require(body[static_cast<size_t>(pair.x)] != body[static_cast<size_t>(pair.y)],
            ErrorKind::Value, name, "[", k,
            "]: expected shapes of two bodies, or of one and the "
            "world, got shapes ",
            pair.x, " and ", pair.y, " of the body ", body[static_cast<size_t>(pair.x)]);
    pair = {std::min(pair.x, pair.y), std::max(pair.x, pair.y)};
  }
  std::sort(pairs.begin(), pairs.end(), less);
  pairs.erase(std::unique(pairs.begin(), pairs.end()), pairs.end());
}

}  // namespace

CollisionPipeline::CollisionPipeline(std::shared_ptr<const Model> model,
                                     const CollisionOptions& options)
    : model_(std::move(model)), options_(options) {
  constexpr const char* name = "CollisionPipeline";
  require(model_ != nullptr, ErrorKind::Value, name, ": model: expected a model, got null");
  require(model_->device().is_cpu() || detail::soft_contact_kernels_source() != nullptr,
          ErrorKind::NotImplemented, name, ": expected a model on the cpu, got one on ",
          model_->device().str(),
          "; this build has no collision for other devices (NOVAPHY_WITH_COLLISION_CUDA)");
  require(options.broad_phase == BroadPhase::Explicit || options.broad_phase == BroadPhase::NxN ||
              options.broad_phase == BroadPhase::Sap,
          ErrorKind::Value, name, ": broad_phase: expected a BroadPhase, got ",
          static_cast<int>(options.broad_phase));
  require(options.narrow_phase != NarrowPhase::Fcl || detail::has_fcl(), ErrorKind::NotImplemented,
          name,
          ": narrow_phase: \"fcl\" needs a build with NOVAPHY_WITH_FCL=ON; this one has it OFF");
  if (options.narrow_phase == NarrowPhase::Fcl)
    require_cpu(model_->device(), name, ": narrow_phase \"fcl\"");
  check_margin(name, options.soft_contact_margin);
  const int32_t soft_max = options.soft_contact_max.value_or(0);
  require(soft_max >= 0, ErrorKind::Value, name, ": soft_contact_max: expected >= 0, got ",
          soft_max);
  const int32_t rigid_max = options.rigid_contact_max.value_or(0);
  require(rigid_max >= 0, ErrorKind::Value, name, ": rigid_contact_max: expected >= 0, got ",
          rigid_max);
  require(options.contacts_per_pair == 8 || options.contacts_per_pair == 4, ErrorKind::Value, name,
          ": contacts_per_pair: expected 8 or 4, got ", options.contacts_per_pair);
  if (options_.shape_pairs_filtered) {
    require(options.broad_phase == BroadPhase::Explicit, ErrorKind::Value, name,
            ": shape_pairs_filtered: expected none with the broad phase \"",
            broad_phase_name(options.broad_phase), "\", which finds its own pairs");
    order_pairs(*options_.shape_pairs_filtered, *model_);
  }
  const auto geometries = std::make_shared<detail::ShapeGeometries>(model_);
  soft_contacts_ = std::make_shared<detail::SoftContacts>(model_, geometries);
  rigid_contacts_ = std::make_shared<detail::RigidContacts>(
      model_, geometries, options.broad_phase, options.narrow_phase, options.contacts_per_pair,
      options_.shape_pairs_filtered);
  soft_contact_pair_count();
  rigid_contact_max();
}

int32_t CollisionPipeline::soft_contact_pair_count() const {
  const ExclusiveUse::Scope scope(*in_use_, "soft_contact_pair_count", "the pipeline");
  return count_pairs();
}

int32_t CollisionPipeline::count_pairs() const { return soft_contacts_->pair_count(); }

int32_t CollisionPipeline::soft_contact_max() const {
  return options_.soft_contact_max ? *options_.soft_contact_max : soft_contact_pair_count();
}

int64_t CollisionPipeline::fcl_pair_count() const { return rigid_contacts_->fcl_pairs(); }
int64_t CollisionPipeline::fcl_fallback_count() const { return rigid_contacts_->fcl_fallbacks(); }

int32_t CollisionPipeline::rigid_contact_max() const {
  const ExclusiveUse::Scope scope(*in_use_, "rigid_contact_max", "the pipeline");
  const int64_t most = rigid_contacts_->most_rows();
  if (options_.rigid_contact_max) return *options_.rigid_contact_max;
  constexpr int64_t kFew = 1000, kPerShape = 64;
  return static_cast<int32_t>(std::min(most, std::max(kFew, kPerShape * model_->shape_count())));
}

Contacts CollisionPipeline::contacts(bool per_contact_shape_properties) const {
  return Contacts({.soft_contact_max = soft_contact_max(),
                   .soft_contact_pair_count = soft_contact_pair_count(),
                   .rigid_contact_max = rigid_contact_max(),
                   .model_id = model_->id(),
                   .requires_grad = options_.requires_grad.value_or(model_->requires_grad),
                   .per_contact_shape_properties = per_contact_shape_properties},
                  model_->device());
}

void CollisionPipeline::collide(const SimState& state, Contacts& contacts,
                                std::optional<float> soft_contact_margin, std::optional<float> dt) {
  constexpr const char* name = "collide";
  const ExclusiveUse::Scope scope(*in_use_, name, "the pipeline");
  const float gap = soft_contact_margin.value_or(options_.soft_contact_margin);
  check_margin(name, gap);
  require(!dt || (std::isfinite(*dt) && *dt > 0.0f), ErrorKind::Value, name,
          ": dt: expected a finite number > 0, got ", dt.value_or(0.0f));
  require(state.model_id() == model_->id(), ErrorKind::Value, name,
          ": state: expected a state of the pipeline's model, got one of another model");
  require(contacts.model_id() == model_->id(), ErrorKind::Value, name,
          ": contacts: expected contacts of the pipeline's model, got others; use "
          "CollisionPipeline.contacts()");
  const auto check_rows = [&](const char* array_name, const Array& array, int32_t rows) {
    require(static_cast<int32_t>(array.rows()) == rows &&
                (rows == 0 || array.device() == model_->device()),
            ErrorKind::Value, name, ": state.", array_name, ": expected ", rows, " rows on ",
            model_->device().str(), ", got ", array.rows(), " rows on ", array.device().str());
  };
  check_rows("particle_q", state.particle_q, model_->particle_count());
  check_rows("body_q", state.body_q, model_->body_count());
  if (dt) check_rows("body_qd", state.body_qd, model_->body_count());
  // With dt the states belong to a rollout, and their values may not exist yet.
  if (launch_recorder() == nullptr && !dt) check_rotations(name, state);
  model_->check_worlds(name);
  const int64_t pairs = count_pairs();
  require(pairs == contacts.soft_contact_pair_count(), ErrorKind::Value, name,
          ": contacts: expected ", pairs, " candidate pairs, got ",
          contacts.soft_contact_pair_count(),
          "; the flags or worlds of shapes or particles were edited, use "
          "CollisionPipeline.contacts() again");
  detail::check_fields<ContactFields>(contacts, contacts.counts(), model_->device(),
                                      "collide: contacts");
  if (LaunchRecorder* recorder = launch_recorder()) recorder->uses(in_use_);
  if (contacts.per_contact_shape_properties()) {
    require(launch_recorder() == nullptr, ErrorKind::NotImplemented, name,
            ": contacts with per_contact_shape_properties cannot be recorded: the materials are "
            "those of the rows of one call, and every call sets them to 0");
    contacts.clear_materials();
  }
  soft_contacts_->collide(state, contacts, gap);
  const uint64_t version = contacts.rigid_contact_count.version();
  rigid_contacts_->collide(state, contacts, dt.value_or(0.0f));
  // If a capture recorded the search, nothing was written yet.
  if (contacts.rigid_contact_count.version() == version) return;
  contacts.set_rigid_contacts_found_from(*model_, state.body_q);
  warn_of_overlaps(state, contacts);
}

void CollisionPipeline::warn_of_overlaps(const SimState& state, const Contacts& contacts) {
  if (!options_.warns_of_overlaps || has_looked_for_overlaps_ || !rigid_contacts_->waits() ||
      *contacts.rigid_contact_count.data() == 0)
    return;
  has_looked_for_overlaps_ = true;
  const std::vector<ShapeOverlap> overlaps = find_overlaps(*model_, state, contacts);
  if (overlaps.empty()) return;
  warn_of("CollisionPipeline: ", overlap_text(*model_, overlaps),
          "; filter_overlaps of add_urdf and add_mjcf leaves them out");
}

}  // namespace novaphy
