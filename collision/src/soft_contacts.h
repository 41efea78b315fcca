// Internal: finds the soft contacts of a model's states on its device. soft_contact_kernels.h has
// the kernels.
#pragma once

#include <cstdint>
#include <memory>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"
#include "shape_geometries.h"

namespace novaphy::detail {

class SoftContacts {
 public:
  SoftContacts(std::shared_ptr<const Model> model, std::shared_ptr<ShapeGeometries> geometries);
  ~SoftContacts();

  // Returns the number of candidate pairs. Reads the model's arrays if they were written since the
  // last call. ErrorKind::NotImplemented: a colliding shape that is not supported.
  int32_t pair_count();
  // Finds the contacts, whose number of candidate pairs must be current. Recorded if the thread
  // records.
  void collide(const SimState& state, Contacts& contacts, float gap);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// The device source of the kernels; null: the build has none.
const char* soft_contact_kernels_source();

}  // namespace novaphy::detail
