// Internal: computes contacts of convex hulls with FCL in place of the engine's narrow phase
// (NarrowPhase::Fcl).
#pragma once

#include <cstdint>
#include <map>

#include "fcl_penetration.h"
#include "novaphy/collision/geometry/rigid_shape.h"

namespace novaphy::detail {

class FclContacts {
 public:
  // Drops the cached hulls if the version of the tables has changed.
  void use_tables(uint64_t version);
  // Replaces the rows of two hulls with overlapping boxes by FCL's result. On entry `kept` has the
  // `count` rows of the engine's narrow phase, and is not initialized if count is 0. Returns the
  // new number of rows.
  int32_t query(const RigidShape& s0, const RigidShape& s1, int32_t count, int32_t per_pair,
                geometry::Manifold& kept);

  // Counts since the start: overlapping pairs, and pairs whose FCL result was rejected.
  int64_t pairs() const { return pairs_; }
  int64_t fallbacks() const { return fallbacks_; }

 private:
  const FclHull& hull_of(const RigidShape& shape);

  std::map<const geometry::GeometryView*, FclHull> hulls_;
  uint64_t version_ = 0;  // version of the tables
  int64_t pairs_ = 0, fallbacks_ = 0;
};

}  // namespace novaphy::detail
