// Internal: finds the rigid contacts of a state on the model's device. The kernels are in
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

  // Returns an upper bound of the number of rows. The function reads the model's arrays if they
  // were written since the last call. ErrorKind::NotImplemented: a pair of shapes that may touch is
  // not supported.
  int64_t most_rows();
  // Returns whether the host can read the contacts as soon as collide() returns.
  bool waits() const;
  // Counts since the start: overlapping pairs of hulls, and pairs whose FCL result was rejected.
  int64_t fcl_pairs() const;
  int64_t fcl_fallbacks() const;
  // Finds the contacts. If a tape or capture of the thread is active, it records the search. `dt`
  // (s): drops contacts that cannot touch within a step of this length. 0: keeps all contacts.
  void collide(const SimState& state, Contacts& contacts, float dt);

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

// The source code of the device kernels. Null: the build has no device kernels.
const char* rigid_contact_kernels_source();
const char* rigid_mesh_kernels_source();

}  // namespace novaphy::detail
