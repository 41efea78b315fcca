// Internal: the soft contacts of a model's states, found on its device. The kernels are those of
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

  // Candidate pairs. The model's arrays are read when they were written since
  // the last call. ErrorKind::NotImplemented: a colliding shape that is not covered.
  int32_t pair_count();
  // The contacts have as many candidate pairs as there are. Recorded where the thread records.
  void collide(const SimState& state, Contacts& contacts, float gap);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// The text of the kernels for devices; null: the build has none.
const char* soft_contact_kernels_source();

}  // namespace novaphy::detail
