// The soft contacts of every particle, as rows: slots(p) are the slots of particle p in ascending
// order.
#pragma once

#include <cstdint>
#include <span>

#include "index_rows.h"
#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"

namespace novaphy {

class ParticleContacts {
 public:
  // Makes the rows anew if the contacts are others than at the last call, or were written since.
  // Keeps its memory. ErrorKind::Index: a slot names a particle or shape that is not there;
  // ErrorKind::NotImplemented: its shape belongs to a body.
  void update(const Model& model, const Contacts& contacts);
  void reset();

  bool empty() const { return rows_.empty(); }
  std::span<const int32_t> slots(int64_t particle) const { return rows_.items(particle); }

 private:
  IndexRows rows_;
  ArrayStamp count_, particle_, shape_, shape_body_;
};

}  // namespace novaphy
