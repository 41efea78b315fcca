// The soft contacts of a step, particle by particle, with their coefficients (sweep.h).
#pragma once

#include <span>
#include <vector>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/index_rows.h"
#include "novaphy/core/sim/model.h"
#include "sweep.h"

namespace novaphy::vbd {

class StepContacts {
 public:
  // Null: none. ErrorKind::Runtime: they overflowed; ErrorKind::Index: of a particle or shape that
  // is not there; ErrorKind::NotImplemented: with a shape of a body.
  void update(const Model& model, const Contacts* contacts, float dt);
  void fill(Sweep& sweep) const;
  // In the order of the rows of a sweep: the slots of the step's contacts.
  std::span<const int32_t> slots() const { return rows_.all(); }
  size_t count() const { return rows_.all().size(); }
  bool touches(int32_t particle) const { return !rows_.empty() && !rows_.items(particle).empty(); }

 private:
  IndexRows rows_;
  std::vector<float> numbers_;
};

}  // namespace novaphy::vbd
