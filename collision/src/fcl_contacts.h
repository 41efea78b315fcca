// Internal: FCL's answers for pairs of convex hulls, in place of the search's own
// (NarrowPhase::Fcl).
#pragma once

#include <cstdint>
#include <map>

#include "fcl_penetration.h"
#include "novaphy/collision/geometry/rigid_shape.h"

namespace novaphy::detail {

class FclContacts {
 public:
  // The hulls of other tables are made anew.
  void use_tables(uint64_t version);
  // Takes FCL's answer for two hulls whose boxes meet. `kept`: the `count` rows that the search has
  // found, and has written only where there are some. Returns how many there are now.
  int32_t ask(const RigidShape& s0, const RigidShape& s1, int32_t count, int32_t per_pair,
              geometry::Manifold& kept);

  // So far: pairs that overlap, and those for which FCL's answer was not taken.
  int64_t pairs() const { return pairs_; }
  int64_t fallbacks() const { return fallbacks_; }

 private:
  const FclHull& hull_of(const RigidShape& shape);

  std::map<const geometry::GeometryView*, FclHull> hulls_;
  uint64_t version_ = 0;  // of the tables
  int64_t pairs_ = 0, fallbacks_ = 0;
};

}  // namespace novaphy::detail
