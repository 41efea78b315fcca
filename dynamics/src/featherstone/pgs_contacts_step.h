// What the two files of PgsContacts share.
#pragma once

#include "pgs_contacts.h"

namespace novaphy {

// What the rows of a step read.
struct PgsContacts::Step {
  const ArticulationArguments& in;
  const Model& model;
  const ContactRows& contacts;
  articulation::ContactLaw<float> law;
  const FeatherstoneOptions& options;
  float warm_scale;  // of the impulses of the step before
  articulation::ShapeMaterials materials;
  articulation::ContactMaterial<float> material(const Row& row) const {
    return articulation::contact_material(materials, contacts, row.contact);
  }
};

inline articulation::ContactLaw<float> contact_law(const FeatherstoneOptions& o, float dt) {
  return {dt,
          o.pgs_erp,
          o.pgs_slop,
          o.pgs_cfm,
          o.max_depenetration_velocity,
          o.restitution_threshold,
          o.compliant_contacts,
          o.friction_cone == FrictionCone::Cone};
}

inline PgsContacts::Step PgsContacts::make_step(const ArticulationArguments& in, const Model& m,
                                                const ContactRows& contacts,
                                                const FeatherstoneOptions& options,
                                                float warm_scale) {
  return {in,
          m,
          contacts,
          contact_law(options, in.dt.value),
          options,
          warm_scale,
          {m.shape_material_mu.data(), m.shape_material_restitution.data(),
           m.shape_material_ke.data(), m.shape_material_kd.data()}};
}

}  // namespace novaphy
