// Internal: soft contacts of a model that is not on the cpu, found on its device with the slots and
// the bits that the cpu gives.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"

namespace novaphy::detail {

class DeviceSoftContacts {
 public:
  explicit DeviceSoftContacts(std::shared_ptr<const Model> model);
  ~DeviceSoftContacts();

  // The shapes that particles may meet. The device's arrays are read when they were written since
  // the last call. ErrorKind::NotImplemented: a colliding shape that is not covered.
  int32_t candidate_count();
  // The contacts have as many candidate pairs as there are.
  void collide(const SimState& state, Contacts& contacts, float gap);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// The text of the device's module: what is fixed, and with the constants before it.
const char* soft_contacts_text();
std::string soft_contacts_module();
// Throws ErrorKind::NotImplemented for a colliding shape that is not covered.
void check_covered_shape(int32_t index, int32_t body, GeoType type);

}  // namespace novaphy::detail
