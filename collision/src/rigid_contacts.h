// Internal: the rigid contacts of a model's states, found on its device. The kernels are those of
// rigid_contact_kernels.h.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <set>
#include <utility>
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

  // Pairs (i < j) that are no candidates any more.
  void leave_out(std::set<std::pair<int32_t, int32_t>> pairs);
  // Rows that no state can exceed. The model's arrays are read when they were written since the
  // last call. ErrorKind::NotImplemented: two shapes that may meet and are not covered.
  int64_t most_rows();
  // So far: pairs of hulls that overlap, and those for which FCL's answer was not taken.
  int64_t fcl_pairs() const;
  int64_t fcl_fallbacks() const;
  // Recorded where the thread records. `dt` (s) of the step that takes the rows: only those that
  // may touch in it; 0: all.
  void collide(const SimState& state, Contacts& contacts, float dt);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// Rows that contacts have by default, of candidates that can have `most`.
int32_t rigid_rows(const Model& model, int64_t most);

// The texts of the kernels for devices; null: the build has none.
const char* rigid_contact_kernels_text();
const char* rigid_mesh_kernels_text();

}  // namespace novaphy::detail
