// The soft contacts of every particle, as rows: slots(p) are the slots of particle p in ascending
// order.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

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

  bool empty() const { return slots_.empty(); }
  std::span<const int32_t> slots(int64_t particle) const {
    const int32_t begin = row_begin_[static_cast<size_t>(particle)];
    const int32_t end = row_begin_[static_cast<size_t>(particle) + 1];
    return {slots_.data() + begin, static_cast<size_t>(end - begin)};
  }

 private:
  std::vector<int32_t> row_begin_;  // particle_count + 1
  std::vector<int32_t> slots_;
  ArrayStamp count_, particle_, shape_, shape_body_;
};

}  // namespace novaphy
