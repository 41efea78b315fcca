// Internal: penetration of convex hulls by FCL's libccd solver, in double precision. Exists only in
// builds with NOVAPHY_WITH_FCL; other builds never make a hull.
//
// The only call is GJKSolver_libccd::shapeIntersect on Convex, because FCL's signed distance and
// planes abort the process for some poses. The call may throw, which counts as no result, and may
// return a zero normal. The call checks nothing, so poses must be finite.
#pragma once

#include <memory>
#include <optional>

#include "novaphy/collision/geometry/shape.h"

namespace novaphy::detail {

bool has_fcl();  // NOVAPHY_WITH_FCL

// A hull in FCL's format. Copies the tables, which must be in host memory.
class FclHull {
 public:
  explicit FclHull(const geometry::HullView& hull);
  ~FclHull();
  FclHull(FclHull&&) noexcept;

  struct Penetration {
    Vec3f normal;  // from the first hull to the second, unchecked
    double depth;  // m
  };
  // Returns nothing if FCL finds no overlap or throws. The second hull is in the frame of the
  // first.
  std::optional<Penetration> penetration(const FclHull& other,
                                         const Transformf& other_in_this) const;

 private:
  struct Impl;
  std::unique_ptr<const Impl> impl_;
};

}  // namespace novaphy::detail
