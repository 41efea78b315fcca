// The soft contacts of every particle: slots(p) are the slots of particle p in ascending order, and
// what they do to it and to the bodies whose shapes they touch.
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
  // Makes the rows anew if the contacts are others than at the last call, or were written since.
  // Keeps its memory. ErrorKind::Index: a slot names a particle, shape or body that is not there.
  void update(const Model& model, const Contacts& contacts);
  void reset();

  bool empty() const { return rows_.empty(); }
  // What every slot does in a state. Keeps its memory.
  // kf_rate: r of diff_soft_contact_trace.h.
  void evaluate(const Model& model, const SimState& state, const Contacts& contacts, float kf_rate);
  // f with the forces of the particle's contacts added in slot order.
  Vec3f add(int64_t particle, Vec3f f) const {
    for (const int32_t slot : rows_.items(particle)) f = f + terms_[static_cast<size_t>(slot)];
    return f;
  }
  // The same of the wrench on a body.
  bool touches_bodies() const { return !body_rows_.empty(); }
  SpatialVectorf add(int64_t body, SpatialVectorf wrench) const;

 private:
  IndexRows rows_, body_rows_;
  std::vector<int32_t> bodies_;  // of every slot; -1: the world
  ArrayStamp count_, particle_, shape_, shape_body_;
  std::vector<Vec3f> terms_;              // of every slot
  std::vector<SpatialVectorf> wrenches_;  // of every slot, where some touch bodies
};

}  // namespace novaphy
