#include "particle_contacts.h"

#include <algorithm>

#include "novaphy/collision/diff_soft_contact_trace.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/for_chunks.h"
#include "novaphy/math/spatial.h"

namespace novaphy {
namespace {
constexpr int64_t kSlotChunk = 256;
}

void ParticleContacts::reset() {
  count_.reset();
  rows_.clear();
  body_rows_.clear();
}

void ParticleContacts::update(const Model &model, const Contacts &contacts) {
  if (count_.matches(contacts.soft_contact_count) &&
      particle_.matches(contacts.soft_contact_particle) &&
      shape_.matches(contacts.soft_contact_shape) && shape_body_.matches(model.shape_body)) {
    return;
  }
  reset();
  const int32_t active =
      std::clamp(*contacts.soft_contact_count.data(), 0, contacts.soft_contact_max());
  const int32_t *particle = contacts.soft_contact_particle.data();
  const int32_t *shape = contacts.soft_contact_shape.data();
  const int32_t *body = model.shape_body.data();
  bodies_.resize(static_cast<size_t>(active));
  for (int32_t slot = 0; slot < active; ++slot) {
    require(particle[slot] >= 0 && particle[slot] < model.particle_count(), ErrorKind::Index,
            "step: contacts: soft_contact_particle[", slot, "]: expected 0 to ",
            model.particle_count() - 1, ", got ", particle[slot]);
    require(shape[slot] >= 0 && shape[slot] < model.shape_count(), ErrorKind::Index,
            "step: contacts: soft_contact_shape[", slot, "]: expected 0 to ",
            model.shape_count() - 1, ", got ", shape[slot]);
    const int32_t owner = body[shape[slot]];
    require(owner >= -1 && owner < model.body_count(), ErrorKind::Index, "step: model.shape_body[",
            shape[slot], "]: expected -1 to ", model.body_count() - 1, ", got ", owner);
    bodies_[static_cast<size_t>(slot)] = owner;
  }

  rows_.build({particle, static_cast<size_t>(active)}, model.particle_count());
  body_rows_.build(bodies_, model.body_count());
  count_.set(contacts.soft_contact_count);
  particle_.set(contacts.soft_contact_particle);
  shape_.set(contacts.soft_contact_shape);
  shape_body_.set(model.shape_body);
}

void ParticleContacts::evaluate(const Model &m, const SimState &state, const Contacts &c,
                                float kf_rate) {
  terms_.resize(bodies_.size());
  if (touches_bodies()) wrenches_.resize(bodies_.size());
  const SoftContactMaterial<float> model_material{m.soft_contact_ke, m.soft_contact_kd,
                                                  m.soft_contact_kf, m.soft_contact_mu};
  const int32_t *const particle = c.soft_contact_particle.data(), *const shape =
                                                                      c.soft_contact_shape.data();
  const Vec3f *const body_pos = c.soft_contact_body_pos.data(),
                     *const body_vel = c.soft_contact_body_vel.data(),
                     *const normal = c.soft_contact_normal.data();
  const Vec3f *const x = state.particle_q.data(), *const v = state.particle_qd.data();
  const float *const radius = m.particle_radius.data(), *const mass = m.particle_mass.data();
  const Transformf *const q = state.body_q.data();
  const SpatialVectorf *const qd = state.body_qd.data();
  const Vec3f *const com = m.body_com.data();
  const float *const ke = m.shape_material_ke.data(), *const kd = m.shape_material_kd.data(),
                     *const kf = m.shape_material_kf.data(), *const mu = m.shape_material_mu.data();
  for_chunks(static_cast<int64_t>(bodies_.size()), kSlotChunk,
             [&](int64_t begin, int64_t end, int64_t) {
               for (int64_t slot = begin; slot < end; ++slot) {
                 const int32_t p = particle[slot], s = shape[slot];
                 const int32_t b = bodies_[static_cast<size_t>(slot)];
                 SoftContactBody<float> at{body_pos[slot], body_vel[slot], {}};
                 if (b >= 0)
                   at = soft_contact_body(q[b], qd[b], com[b], body_pos[slot], body_vel[slot]);
                 const Vec3f term = soft_contact_force_term(
                     x[p], v[p], radius[p], at.position, at.velocity, normal[slot],
                     with_bounded_kf(
                         mean_soft_contact_material(model_material, {ke[s], kd[s], kf[s], mu[s]}),
                         mass[p], kf_rate),
                     m.particle_adhesion);
                 terms_[static_cast<size_t>(slot)] = term;
                 if (b >= 0)
                   wrenches_[static_cast<size_t>(slot)] = {-term, math::cross(at.arm, -term)};
               }
             });
}

SpatialVectorf ParticleContacts::add(int64_t body, SpatialVectorf wrench) const {
  for (const int32_t slot : body_rows_.items(body))
    wrench = wrench + wrenches_[static_cast<size_t>(slot)];
  return wrench;
}

}  // namespace novaphy
