#include "particle_contacts.h"

#include <algorithm>

#include "novaphy/core/error.h"

namespace novaphy {

void ParticleContacts::reset() {
  count_.reset();
  rows_.clear();
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

  rows_.build({particle, static_cast<size_t>(active)}, model.particle_count());
  count_.set(contacts.soft_contact_count);
  particle_.set(contacts.soft_contact_particle);
  shape_.set(contacts.soft_contact_shape);
  shape_body_.set(model.shape_body);
}

}  // namespace novaphy
