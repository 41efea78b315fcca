#include "step_contacts.h"

#include "novaphy/core/assert.h"
#include "novaphy/core/error.h"
#include "novaphy/vbd/contact_numbers_trace.h"

namespace novaphy::vbd {
void StepContacts::update(const Model& model, const Contacts* contacts, float dt) {
  constexpr const char* kName = "SolverVBD.step: contacts";
  rows_.clear();
  if (contacts == nullptr) return;
  const int32_t count = *contacts->soft_contact_count.data();
  require(count <= contacts->soft_contact_max(), ErrorKind::Runtime, kName, ": ", count,
          " were found, but there are slots for ", contacts->soft_contact_max(),
          "; make a pipeline with a larger soft_contact_max");
  if (count <= 0) return;
  const int32_t* particle = contacts->soft_contact_particle.data();
  const int32_t* shape = contacts->soft_contact_shape.data();
  const int32_t* body = model.shape_body.data();
  for (int32_t slot = 0; slot < count; ++slot) {
    require(particle[slot] >= 0 && particle[slot] < model.particle_count(), ErrorKind::Index, kName,
            ".soft_contact_particle[", slot, "]: expected 0 to ", model.particle_count() - 1,
            ", got ", particle[slot]);
    require(shape[slot] >= 0 && shape[slot] < model.shape_count(), ErrorKind::Index, kName,
            ".soft_contact_shape[", slot, "]: expected 0 to ", model.shape_count() - 1, ", got ",
            shape[slot]);
    require(body[shape[slot]] < 0, ErrorKind::NotImplemented, kName, ": slot ", slot,
            " touches shape ", shape[slot], " of body ", body[shape[slot]],
            "; contacts with bodies are not there yet");
  }
  rows_.build({particle, static_cast<size_t>(count)}, model.particle_count());

  const Vec3f* point = contacts->soft_contact_body_pos.data();
  const Vec3f* velocity = contacts->soft_contact_body_vel.data();
  const Vec3f* normal = contacts->soft_contact_normal.data();
  const float* radius = model.particle_radius.data();
  const float* margin = model.shape_margin.data();
  const float* ke = model.shape_material_ke.data();
  const float* kd = model.shape_material_kd.data();
  const float* mu = model.shape_material_mu.data();
  numbers_.resize(rows_.all().size() * kContactFloats);
  float* row = numbers_.data();
  for (const int32_t slot : rows_.all()) {
    const int32_t s = shape[slot];
    put_contact_numbers(row, point[slot], normal[slot], velocity[slot],
                        radius[particle[slot]] + margin[s],
                        {model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu},
                        {ke[s], kd[s], mu[s]}, dt);
    row += kContactFloats;
  }
  NOVAPHY_ASSERT(row == numbers_.data() + numbers_.size());
}

void StepContacts::fill(Sweep& sweep) const {
  sweep.contact_begin = rows_.empty() ? nullptr : rows_.begins().data();
  sweep.contacts = numbers_.data();
}

}  // namespace novaphy::vbd
