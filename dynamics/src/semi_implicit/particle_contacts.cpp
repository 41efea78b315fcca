#include "particle_contacts.h"

#include <algorithm>

#include "novaphy/core/error.h"

namespace novaphy {

void ParticleContacts::reset() {
  count_.reset();
  slots_.clear();
}

void ParticleContacts::update(const Model& model, const Contacts& contacts) {
  if (count_.matches(contacts.soft_contact_count) &&
      particle_.matches(contacts.soft_contact_particle) &&
      shape_.matches(contacts.soft_contact_shape) && shape_body_.matches(model.shape_body)) {
    return;
  }
  reset();
  const int32_t active =
      std::clamp(*contacts.soft_contact_count.data(), 0, contacts.soft_contact_max());
  const int32_t* particle = contacts.soft_contact_particle.data();
  const int32_t* shape = contacts.soft_contact_shape.data();
  const int32_t* body = model.shape_body.data();
  for (int32_t slot = 0; slot < active; ++slot) {
    require(particle[slot] >= 0 && particle[slot] < model.particle_count(), ErrorKind::Index,
            "step: contacts: soft_contact_particle[", slot, "]: expected 0 to ",
            model.particle_count() - 1, ", got ", particle[slot]);
    require(shape[slot] >= 0 && shape[slot] < model.shape_count(), ErrorKind::Index,
            "step: contacts: soft_contact_shape[", slot, "]: expected 0 to ",
            model.shape_count() - 1, ", got ", shape[slot]);
    require(body[shape[slot]] < 0, ErrorKind::NotImplemented, "step: contacts: slot ", slot,
            " touches shape ", shape[slot], " of body ", body[shape[slot]],
            "; contacts with bodies are not there yet");
  }

  // A stable counting sort by particle.
  row_begin_.assign(static_cast<size_t>(model.particle_count()) + 1, 0);
  for (int32_t slot = 0; slot < active; ++slot)
    ++row_begin_[static_cast<size_t>(particle[slot]) + 1];
  for (size_t p = 1; p < row_begin_.size(); ++p) row_begin_[p] += row_begin_[p - 1];
  slots_.resize(static_cast<size_t>(active));
  for (int32_t slot = 0; slot < active; ++slot) {
    // row_begin_[p] runs ahead to the row's end and is put back below.
    slots_[static_cast<size_t>(row_begin_[static_cast<size_t>(particle[slot])]++)] = slot;
  }
  for (size_t p = row_begin_.size() - 1; p > 0; --p) row_begin_[p] = row_begin_[p - 1];
  row_begin_[0] = 0;

  count_.set(contacts.soft_contact_count);
  particle_.set(contacts.soft_contact_particle);
  shape_.set(contacts.soft_contact_shape);
  shape_body_.set(model.shape_body);
}

}  // namespace novaphy
