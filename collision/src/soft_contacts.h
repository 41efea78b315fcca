// Internal: finds the soft contacts of a state on the model's device. The kernels are in
// soft_contact_kernels.h.
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

  // Returns the number of candidate pairs. The function reads the model's arrays if they were
  // written since the last call. ErrorKind::NotImplemented: a colliding shape that is not
  // supported.
  int32_t pair_count();
  // Finds the contacts. The number of candidate pairs in `contacts` must be up to date. `gap` (m)
  // is the soft_contact_margin. If the thread records, the search is recorded.
  void collide(const SimState& state, Contacts& contacts, float gap);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// The source code of the device kernels. Null: the build has no device kernels.
const char* soft_contact_kernels_source();

}  // namespace novaphy::detail
