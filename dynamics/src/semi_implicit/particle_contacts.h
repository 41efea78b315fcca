// ParticleContacts: the soft contacts of every particle in ascending order of slots, with their
// forces on the particle and on the bodies of the shapes.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/index_rows.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"

namespace novaphy {

class ParticleContacts {
 public:
  // Builds the lists of contacts again if other contacts are given, or if the contacts were written
  // since the last call. Reuses its memory. ErrorKind::Index: a slot names a particle, shape or
  // body that does not exist.
  void update(const Model& model, const Contacts& contacts);
  void reset();

  bool empty() const { return rows_.empty(); }
  // Evaluates the forces of every slot in a state. Reuses its memory. kf_rate: the symbol r of
  // diff_soft_contact_trace.h.
  void evaluate(const Model& model, const SimState& state, const Contacts& contacts, float kf_rate);
  // Returns f plus the forces of the particle's contacts, in slot order.
  Vec3f add(int64_t particle, Vec3f f) const {
    for (const int32_t slot : rows_.items(particle)) f = f + terms_[static_cast<size_t>(slot)];
    return f;
  }
  // Returns whether a contact touches a body. The `add` below returns the wrench plus those of a
  // body's contacts.
  bool touches_bodies() const { return !body_rows_.empty(); }
  SpatialVectorf add(int64_t body, SpatialVectorf wrench) const;

 private:
  IndexRows rows_, body_rows_;
  std::vector<int32_t> bodies_;  // body of every slot; -1: the world
  ArrayStamp count_, particle_, shape_, shape_body_;
  std::vector<Vec3f> terms_;              // of every slot
  std::vector<SpatialVectorf> wrenches_;  // of every slot, if a slot touches a body
};

}  // namespace novaphy
