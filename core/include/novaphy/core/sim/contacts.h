// Contacts: the buffers that a collision pipeline fills and solvers read. Made by
// CollisionPipeline::contacts().
#pragma once

#include <cstdint>
#include <vector>

#include "novaphy/core/sim/fields.h"

namespace novaphy {

struct ContactCounts {
  int32_t soft_contact_max = 0;         // slots
  int32_t soft_contact_pair_count = 0;  // candidate (particle, shape) pairs
  int32_t one = 1;
  bool operator==(const ContactCounts&) const = default;
};

// X(name, element type, width, count, unit, frame, doc). The frame "body, or world" is the
// frame of the shape's body, the world for a world-owned shape.
// clang-format off
#define NOVAPHY_CONTACT_FIELDS(X)                                                                 \
  X(soft_contact_count, int32_t, 1, one, "", "",                                                  \
    "soft contacts found; may exceed soft_contact_max, consumers use min(count, max)")            \
  X(soft_contact_particle, int32_t, 1, soft_contact_max, "", "",                                  \
    "particle; -1 in an unused slot")                                                             \
  X(soft_contact_shape, int32_t, 1, soft_contact_max, "", "", "shape; -1 in an unused slot")      \
  X(soft_contact_body_pos, Vec3f, 1, soft_contact_max, "m", "body, or world",                     \
    "closest point of the shape's surface, without its margin")                                   \
  X(soft_contact_body_vel, Vec3f, 1, soft_contact_max, "m/s", "body, or world",                   \
    "velocity of that point relative to the body")                                                \
  X(soft_contact_normal, Vec3f, 1, soft_contact_max, "1", "world",                                \
    "unit normal, out of the shape to the particle")                                              \
  X(soft_contact_tids, int32_t, 1, soft_contact_pair_count, "", "",                               \
    "slot of every candidate pair, shape-major; -1 where there is no contact or no slot was "     \
    "left")                                                                                       \
  X(contact_generation, int32_t, 1, one, "", "", "raised by clear() and by every collide")
// clang-format on

NOVAPHY_DECLARE_FIELDS(ContactFields, NOVAPHY_CONTACT_FIELDS, ContactCounts)

// One soft contact, on the host.
struct SoftContact {
  int32_t particle = -1, shape = -1;
  Vec3f body_pos{}, body_vel{}, normal{};
  bool operator==(const SoftContact&) const = default;
};

struct ContactsOptions {
  int32_t soft_contact_max = 0;
  int32_t soft_contact_pair_count = 0;
  uint64_t model_id = 0;  // Model::id() of their model; 0: none, and no pipeline takes them
  bool requires_grad = false;
};

// Contacts of particles with shapes ("soft contacts"). The capacity is fixed: when more contacts
// are found than there are slots, the first soft_contact_max in candidate order are kept,
// soft_contact_count still says how many there are, and overflowed() is true. Move-only, as
// SimState.
class NOVAPHY_CORE_API Contacts : public ContactFields {
 public:
  using Fields = ContactFields;

  // ErrorKind::Value on a negative count.
  explicit Contacts(const ContactsOptions& options = {}, Device device = default_device());
  Contacts(Contacts&&) = default;
  Contacts& operator=(Contacts&&) = default;

  const ContactCounts& counts() const { return counts_; }
  int32_t soft_contact_max() const { return counts_.soft_contact_max; }
  int32_t soft_contact_pair_count() const { return counts_.soft_contact_pair_count; }
  Device device() const { return device_; }
  uint64_t model_id() const { return model_id_; }
  bool requires_grad = false;

  // No contacts: the count 0, every slot unused; raises contact_generation.
  void clear();
  // min(count, max) on the host: the slots that hold a contact. Reads from the device.
  int32_t active_soft_contact_count() const;
  // True if contacts were found that no slot was left for. Reads from the device.
  bool overflowed() const;
  // The contacts, in slot order. Reads from the device.
  std::vector<SoftContact> soft_contacts() const;
  void assign(
      const Contacts& source);  // ErrorKind::Value when an array's rows or the device differ
  Contacts clone() const;

 private:
  Contacts(const Contacts& source, ContactFields fields);

  ContactCounts counts_;
  Device device_;
  uint64_t model_id_ = 0;
};

}  // namespace novaphy
