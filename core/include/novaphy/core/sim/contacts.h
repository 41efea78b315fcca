// Contacts: the buffers that a collision pipeline fills and solvers read.
// CollisionPipeline::contacts() makes them.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/fields.h"

namespace novaphy {

class Model;

struct ContactCounts {
  int32_t soft_contact_max = 0;         // number of slots
  int32_t soft_contact_pair_count = 0;  // candidate pairs (particle, shape)
  int32_t rigid_contact_max = 0;        // number of rows
  int32_t rigid_contact_materials = 0;  // rows with their own material: all rows or 0
  int32_t one = 1;
  bool operator==(const ContactCounts&) const = default;
};

// X(name, element type, width, count, unit, frame, doc). The frame "body, or world" is the frame of
// the shape's body. For a world-owned shape the frame is the world.
#define NOVAPHY_CONTACT_FIELDS(X)                                                                 \
  X(soft_contact_count, int32_t, 1, one, "", "",                                                  \
    "number of soft contacts found, which may exceed soft_contact_max")                           \
  X(soft_contact_particle, int32_t, 1, soft_contact_max, "", "", "particle; -1: unused slot")     \
  X(soft_contact_shape, int32_t, 1, soft_contact_max, "", "", "shape; -1: unused slot")           \
  X(soft_contact_body_pos, Vec3f, 1, soft_contact_max, "m", "body, or world",                     \
    "closest point of the shape's surface, without its margin")                                   \
  X(soft_contact_body_vel, Vec3f, 1, soft_contact_max, "m/s", "body, or world",                   \
    "velocity of that point relative to the body")                                                \
  X(soft_contact_normal, Vec3f, 1, soft_contact_max, "1", "world",                                \
    "unit normal, out of the shape to the particle")                                              \
  X(soft_contact_tids, int32_t, 1, soft_contact_pair_count, "", "",                               \
    "slot of each candidate pair, ordered by shape; -1: no contact, or no free slot")             \
  X(rigid_contact_count, int32_t, 1, one, "", "",                                                 \
    "number of rigid contacts found, which may exceed rigid_contact_max")                         \
  X(rigid_contact_shape0, int32_t, 1, rigid_contact_max, "", "",                                  \
    "shape A, of the smaller GeoType (or index, for equal types); -1 in an unused row")           \
  X(rigid_contact_shape1, int32_t, 1, rigid_contact_max, "", "", "shape B; -1 in an unused row")  \
  X(rigid_contact_point0, Vec3f, 1, rigid_contact_max, "m", "body, or world",                     \
    "core point of A: on its surface, or center of a sphere, or on the axis of a capsule")        \
  X(rigid_contact_point1, Vec3f, 1, rigid_contact_max, "m", "body, or world", "core point of B")  \
  X(rigid_contact_offset0, Vec3f, 1, rigid_contact_max, "m", "body, or world",                    \
    "from point0 to A's surface with its margin: normal * margin0")                               \
  X(rigid_contact_offset1, Vec3f, 1, rigid_contact_max, "m", "body, or world",                    \
    "from point1 to B's surface with its margin: -normal * margin1")                              \
  X(rigid_contact_normal, Vec3f, 1, rigid_contact_max, "1", "world", "unit normal, from A to B")  \
  X(rigid_contact_margin0, float, 1, rigid_contact_max, "m", "",                                  \
    "radius of A (sphere, capsule) plus its shape_margin")                                        \
  X(rigid_contact_margin1, float, 1, rigid_contact_max, "m", "", "radius of B plus shape_margin") \
  X(rigid_contact_point_id, int32_t, 1, rigid_contact_max, "", "",                                \
    "number of the pair of features that touch; -1 in an unused row")                             \
  X(rigid_contact_stiffness, float, 1, rigid_contact_materials, "N/m", "",                        \
    "> 0: ke of the row, instead of the shapes' ke; needs per_contact_shape_properties")          \
  X(rigid_contact_damping, float, 1, rigid_contact_materials, "N*s/m", "",                        \
    "> 0: kd of the row, instead of the shapes' kd")                                              \
  X(rigid_contact_friction, float, 1, rigid_contact_materials, "1", "",                           \
    "> 0: mu of the row, instead of the shapes' mu")                                              \
  X(rigid_contact_force, Vec3f, 1, rigid_contact_max, "N", "world",                               \
    "force on B, written by solvers; A gets the opposite")                                        \
  X(contact_generation, int32_t, 1, one, "", "", "counts the calls of clear() and collide")
// clang-format on

NOVAPHY_DECLARE_FIELDS(ContactFields, NOVAPHY_CONTACT_FIELDS, ContactCounts)

// One soft contact, copied to the host.
struct SoftContact {
  int32_t particle = -1, shape = -1;
  Vec3f body_pos{}, body_vel{}, normal{};
  bool operator==(const SoftContact&) const = default;
};

// One rigid contact, copied to the host.
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
  uint64_t model_id = 0;  // Model::id() of the model; 0: no model, and every pipeline refuses these
                          // contacts
  bool requires_grad = false;
  bool per_contact_shape_properties = false;  // allocates rigid_contact_stiffness, _damping and
                                              // _friction
};

// Contacts of particles with shapes ("soft contacts") and of shapes with each other ("rigid
// contacts"). Both capacities are fixed. If the search finds more contacts than slots, the first
// soft_contact_max (rigid_contact_max) contacts in their order are kept. The count still has the
// number found, and overflowed() is true. Move-only, like SimState.
class NOVAPHY_CORE_API Contacts : public ContactFields {
 public:
  using Fields = ContactFields;

  // Throws ErrorKind::Value for a negative count.
  explicit Contacts(const ContactsOptions& options = {}, Device device = default_device());
  Contacts(Contacts&&) = default;
  Contacts& operator=(Contacts&&) = default;

  const ContactCounts& counts() const { return counts_; }
  int32_t soft_contact_max() const { return counts_.soft_contact_max; }
  int32_t soft_contact_pair_count() const { return counts_.soft_contact_pair_count; }
  int32_t rigid_contact_max() const { return counts_.rigid_contact_max; }
  // Returns whether each row may have its own material. The materials belong to the present rows:
  // collide and clear() set them to 0, and 0 selects the material of the shapes.
  bool per_contact_shape_properties() const { return counts_.rigid_contact_materials > 0; }
  Device device() const { return device_; }
  uint64_t model_id() const { return model_id_; }
  bool requires_grad = false;

  // Removes all contacts: sets the count to 0, marks every slot unused, and raises
  // contact_generation.
  void clear();
  // Gives every row the material of its shapes again.
  void clear_materials();
  // Throws ErrorKind::Value, with `function` in the message, unless the materials of all rows are
  // finite and >= 0. Materials on other devices than the CPU are not read.
  void check_materials(const char* function) const;
  // Returns min(count, max): the number of slots with a contact. Reads from the device.
  int32_t active_soft_contact_count() const;
  int32_t active_rigid_contact_count() const;
  // Returns whether the search found more contacts than slots. Reads from the device.
  bool overflowed() const;
  // Returns the contacts in slot order. Reads from the device.
  std::vector<SoftContact> soft_contacts() const;
  std::vector<RigidContact> rigid_contacts() const;
  void assign(
      const Contacts& source);  // ErrorKind::Value when an array's rows or the device differ
  Contacts clone() const;       // also copies the record of the poses (see below)

  // Records that the rows of rigid contacts belong to these poses and to the present shapes of the
  // model. A pipeline calls this function after its search.
  void set_rigid_contacts_found_from(const Model& model, const Array& body_q);
  // Returns whether the rows belong to these poses. Since the search, nothing may have written to
  // poses, shapes or rows, and no writable export may have existed. The answer is false for rows
  // that a captured graph found and for rows that assign() copied.
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
  std::array<ArrayStamp, kRowArrays> as_found_;  // stamps of the arrays of rigid_contact_* that
                                                 // steps read
};

}  // namespace novaphy
