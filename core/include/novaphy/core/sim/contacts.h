// Contacts: the buffers that a collision pipeline fills and solvers read. Made by
// CollisionPipeline::contacts().
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/fields.h"

namespace novaphy {

class Model;

struct ContactCounts {
  int32_t soft_contact_max = 0;         // slots
  int32_t soft_contact_pair_count = 0;  // candidate (particle, shape) pairs
  int32_t rigid_contact_max = 0;        // rows
  int32_t rigid_contact_materials = 0;  // rows with a material of their own: all or none
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
  X(rigid_contact_count, int32_t, 1, one, "", "",                                                 \
    "rigid contacts found; may exceed rigid_contact_max, consumers use min(count, max)")          \
  X(rigid_contact_shape0, int32_t, 1, rigid_contact_max, "", "",                                  \
    "shape A, of the smaller GeoType (of two alike: the smaller index); -1 in an unused row")     \
  X(rigid_contact_shape1, int32_t, 1, rigid_contact_max, "", "", "shape B; -1 in an unused row")  \
  X(rigid_contact_point0, Vec3f, 1, rigid_contact_max, "m", "body, or world",                     \
    "point of A's core: the surface of A, or the center of a sphere, the axis of a capsule")      \
  X(rigid_contact_point1, Vec3f, 1, rigid_contact_max, "m", "body, or world", "the same of B")    \
  X(rigid_contact_offset0, Vec3f, 1, rigid_contact_max, "m", "body, or world",                    \
    "from point0 to A's surface with its margin: normal * margin0")                               \
  X(rigid_contact_offset1, Vec3f, 1, rigid_contact_max, "m", "body, or world",                    \
    "the same of B: -normal * margin1")                                                           \
  X(rigid_contact_normal, Vec3f, 1, rigid_contact_max, "1", "world", "unit normal, from A to B")  \
  X(rigid_contact_margin0, float, 1, rigid_contact_max, "m", "",                                  \
    "radius of A (sphere, capsule) plus its shape_margin")                                        \
  X(rigid_contact_margin1, float, 1, rigid_contact_max, "m", "", "the same of B")                 \
  X(rigid_contact_point_id, int32_t, 1, rigid_contact_max, "", "",                                \
    "feature of the pair that touches; -1 in an unused row")                                      \
  X(rigid_contact_stiffness, float, 1, rigid_contact_materials, "N/m", "",                        \
    "where it is > 0 the row's ke, instead of its shapes'; no rows unless asked for")             \
  X(rigid_contact_damping, float, 1, rigid_contact_materials, "N*s/m", "", "kd likewise")         \
  X(rigid_contact_friction, float, 1, rigid_contact_materials, "1", "", "mu likewise")            \
  X(rigid_contact_force, Vec3f, 1, rigid_contact_max, "N", "world",                               \
    "force on B, written by solvers; A gets the opposite")                                        \
  X(contact_generation, int32_t, 1, one, "", "", "raised by clear() and by every collide")
// clang-format on

NOVAPHY_DECLARE_FIELDS(ContactFields, NOVAPHY_CONTACT_FIELDS, ContactCounts)

// One soft contact, on the host.
struct SoftContact {
  int32_t particle = -1, shape = -1;
  Vec3f body_pos{}, body_vel{}, normal{};
  bool operator==(const SoftContact&) const = default;
};

// One rigid contact, on the host.
struct RigidContact {
  int32_t shape0 = -1, shape1 = -1;
  Vec3f point0{}, point1{}, offset0{}, offset1{}, normal{};
  float margin0 = 0.0f, margin1 = 0.0f;
  int32_t point_id = -1;
  Vec3f force{};
  bool operator==(const RigidContact&) const = default;
};

struct ContactsOptions {
  int32_t soft_contact_max = 0;
  int32_t soft_contact_pair_count = 0;
  int32_t rigid_contact_max = 0;
  uint64_t model_id = 0;  // Model::id() of their model; 0: none, and no pipeline takes them
  bool requires_grad = false;
  bool per_contact_shape_properties = false;  // rigid_contact_stiffness, _damping, _friction
};

// Contacts of particles with shapes ("soft contacts") and of shapes with each other ("rigid
// contacts"). Both capacities are fixed: when more contacts are found than there are slots, the
// first soft_contact_max (rigid_contact_max) in their order are kept, the count still says how many
// there are, and overflowed() is true. Move-only, as SimState.
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
  int32_t rigid_contact_max() const { return counts_.rigid_contact_max; }
  // Whether rows may have materials of their own. They belong to the rows that are there: collide
  // and clear() set them to 0, so that the shapes' count.
  bool per_contact_shape_properties() const { return counts_.rigid_contact_materials > 0; }
  Device device() const { return device_; }
  uint64_t model_id() const { return model_id_; }
  bool requires_grad = false;

  // No contacts: the count 0, every slot unused; raises contact_generation.
  void clear();
  // Every row has the material of its shapes again.
  void clear_materials();
  // ErrorKind::Value, naming `function`, unless the materials of rows are finite and >= 0. On other
  // devices than the CPU they are not read.
  void check_materials(const char* function) const;
  // min(count, max) on the host: the slots that hold a contact. Read from the device.
  int32_t active_soft_contact_count() const;
  int32_t active_rigid_contact_count() const;
  // True if contacts were found that no slot was left for. Reads from the device.
  bool overflowed() const;
  // The contacts, in slot order. Reads from the device.
  std::vector<SoftContact> soft_contacts() const;
  std::vector<RigidContact> rigid_contacts() const;
  void assign(
      const Contacts& source);  // ErrorKind::Value when an array's rows or the device differ
  Contacts clone() const;       // knows too which poses its rows were found from

  // Says that the rows of rigid contacts were found from these poses and the shapes of the model,
  // as they are now. A pipeline does so behind its search.
  void set_rigid_contacts_found_from(const Model& model, const Array& body_q);
  // Whether they were, and neither poses nor shapes nor rows have been written since, or could have
  // been by who has a writable export of them. False for rows that a launch of a captured graph has
  // found or that assign() has copied.
  bool rigid_contacts_found_from(const Model& model, const Array& body_q) const;

 private:
  static constexpr size_t kSources = 5, kRowArrays = 8;
  Contacts(const Contacts& source, ContactFields fields);
  std::array<const Array*, kRowArrays> row_arrays() const;
  bool rows_are_as_found() const;

  ContactCounts counts_;
  Device device_;
  uint64_t model_id_ = 0;
  std::array<ArrayStamp, kSources> found_from_;
  std::array<ArrayStamp, kRowArrays> as_found_;  // what steps read of rigid_contact_*
};

}  // namespace novaphy
