// Internal: the rigid contacts of a model's states, found on its device. The kernels are those of
// rigid_contact_kernels.h.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "novaphy/collision/broad_phase.h"
#include "novaphy/collision/narrow_phase.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"
#include "shape_geometries.h"

namespace novaphy::detail {

class RigidContacts {
 public:
  RigidContacts(std::shared_ptr<const Model> model, std::shared_ptr<ShapeGeometries> geometries,
                BroadPhase broad_phase, NarrowPhase narrow_phase, int32_t contacts_per_pair,
                std::optional<std::vector<Vec2i>> explicit_pairs);
  ~RigidContacts();

  // Rows that no state can exceed. The model's arrays are read when they were written since the
  // last call. ErrorKind::NotImplemented: two shapes that may meet and are not covered.
  int64_t most_rows();
  // Whether what a search finds is there for the host when collide returns.
  bool waits() const;
  // Counts since the start: overlapping pairs of hulls, and pairs whose answer of FCL was not used.
  int64_t fcl_pairs() const;
  int64_t fcl_fallbacks() const;
  // Recorded where the thread records. `dt` (s) of the step that takes the rows: only those that
  // may touch in it; 0: all.
  void collide(const SimState& state, Contacts& contacts, float dt);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// The texts of the kernels for devices; null: the build has none.
const char* rigid_contact_kernels_source();
const char* rigid_mesh_kernels_source();

}  // namespace novaphy::detail
