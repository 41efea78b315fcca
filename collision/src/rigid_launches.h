// Internal: the launches of the search for rigid contacts, in their order, and the memory between
// them. The kernels are those of rigid_contact_kernels.h and rigid_mesh_kernels.h.
#pragma once

#include <cstdint>
#include <span>

#include "novaphy/collision/geometry/rigid_shape.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"
#include "rigid_pairs.h"
#include "shape_geometries.h"

namespace novaphy {
struct RigidContactShapeArguments;
}

namespace novaphy::detail {

class RigidLaunches {
 public:
  // Moves the shapes to the world. `dt`: see RigidContacts::collide.
  void move(const Model& model, const SimState& state, const ShapeGeometries& geometries, float dt);
  // The same of some shapes only, on the CPU, where nobody records.
  void move_some(const Model& model, const SimState& state, const ShapeGeometries& geometries,
                 float dt, std::span<const int32_t> moved);
  // The rest for at least one pair.
  void find(const RigidPairs& pairs, int32_t contacts_per_pair);
  void scan(const RigidPairs& pairs);
  // Leaves out the rows that are farthest apart where there are more than `capacity`, and scans
  // again.
  void limit(const RigidPairs& pairs, int64_t capacity);
  // `limited`: behind limit().
  void write(const RigidPairs& pairs, bool limited, const Contacts& contacts);
  // Empties the rows behind the contacts, up to `last`, and the forces of the others.
  void clear(int64_t pairs, int64_t last, const Contacts& contacts);

  const Array& shapes() const { return shapes_; }
  // On the host; empty before they were moved.
  std::span<const RigidShape> host_shapes() const;
  geometry::Manifold* host_manifolds() const;
  int32_t* host_counts() const;
  // Behind the scan.
  int64_t rows_found(const RigidPairs& pairs) const;

 private:
  void reserve(const RigidPairs& pairs);
  RigidContactShapeArguments shape_arguments(const Model& model, const SimState& state,
                                             const ShapeGeometries& geometries, float dt,
                                             const Array& views);
  void scan(const DeviceArray<int32_t>& counts, int64_t count, const DeviceArray<int32_t>& before);
  void find_limit(const RigidPairs& pairs, int64_t capacity);

  Array shapes_, manifolds_, mesh_contacts_;  // of RigidShape, Manifold, MeshRows
  DeviceArray<int32_t> counts_, before_;      // PairRows
  DeviceArray<int32_t> sums_;                 // of a scan
  DeviceArray<int32_t> filled_;               // how many rows were written
  // Of limit().
  DeviceArray<int32_t> limit_sums_, farther_, farther_before_;
  Array limit_;  // a RigidContactLimit
};

}  // namespace novaphy::detail
