// Internal: the launches of the search for rigid contacts, in order, and their temporary memory.
// The kernels are in rigid_contact_kernels.h and rigid_mesh_kernels.h.
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
  // Transforms the shapes to the world frame. `dt`: see RigidContacts::collide.
  void move(const Model& model, const SimState& state, const ShapeGeometries& geometries, float dt);
  // Transforms only the shapes `moved`, on the CPU and outside of recordings.
  void move_some(const Model& model, const SimState& state, const ShapeGeometries& geometries,
                 float dt, std::span<const int32_t> moved);
  // Computes the contacts of the pairs, of which at least one must exist.
  void find(const RigidPairs& pairs, int32_t contacts_per_pair);
  void scan(const RigidPairs& pairs);
  // If more than `capacity` rows exist, removes the rows with the largest distances, and scans
  // again.
  void limit(const RigidPairs& pairs, int64_t capacity);
  // Writes the rows. `limited`: whether limit() was called.
  void write(const RigidPairs& pairs, bool limited, const Contacts& contacts);
  // Clears the rows after the contacts, up to `last`, and clears the forces of valid rows.
  void clear(int64_t pairs, int64_t last, const Contacts& contacts);

  const Array& shapes() const { return shapes_; }
  // The arrays as host memory. host_shapes() is empty before the first call of move().
  std::span<const RigidShape> host_shapes() const;
  geometry::Manifold* host_manifolds() const;
  int32_t* host_counts() const;
  // Returns the number of rows. Requires a call of scan().
  int64_t rows_found(const RigidPairs& pairs) const;

 private:
  void reserve(const RigidPairs& pairs);
  RigidContactShapeArguments shape_arguments(const Model& model, const SimState& state,
                                             const ShapeGeometries& geometries, float dt,
                                             const Array& views);
  void scan(const DeviceArray<int32_t>& counts, int64_t count, const DeviceArray<int32_t>& before);
  void find_limit(const RigidPairs& pairs, int64_t capacity);

  Array shapes_, manifolds_, mesh_contacts_;  // rows of RigidShape, Manifold, MeshRows
  Array mesh_scratch_;                        // rows of MeshContacts, on devices
  DeviceArray<int32_t> counts_, before_;      // the arrays of PairRows
  DeviceArray<int32_t> sums_;                 // sums of chunks, for a scan
  DeviceArray<int32_t> filled_;               // number of written rows
  // Temporary memory of limit().
  DeviceArray<int32_t> limit_sums_, farther_, farther_before_;
  Array limit_;  // a single RigidContactLimit
};

}  // namespace novaphy::detail
