// Internal: overlapping convex hulls by FCL's solver over libccd, in double precision. Only where
// the build has it (NOVAPHY_WITH_FCL); without it, hulls are never made.
//
// The only call is GJKSolver_libccd::shapeIntersect on Convex: the signed distance and the planes
// of FCL end the process for some poses. The call may throw, which here is no answer, and its
// normal may be zero. The call refuses nothing, so poses must be finite.
#pragma once

#include <memory>
#include <optional>

#include "novaphy/collision/geometry/shape.h"

namespace novaphy::detail {

bool has_fcl();  // NOVAPHY_WITH_FCL

// A hull as FCL wants it. Copies the tables, which lie in the memory of the host.
class FclHull {
 public:
  explicit FclHull(const geometry::HullView& hull);
  ~FclHull();
  FclHull(FclHull&&) noexcept;

  struct Penetration {
    Vec3f normal;  // from the first to the second, not checked
    double depth;  // m
  };
  // Nothing where FCL finds no overlap, or throws. The second hull in the frame of the first.
  std::optional<Penetration> penetration(const FclHull& other,
                                         const Transformf& other_in_this) const;

 private:
  struct Impl;
  std::unique_ptr<const Impl> impl_;
};

}  // namespace novaphy::detail
