// Internal: penetration of convex hulls by FCL's libccd solver, in double precision. Builds without
// NOVAPHY_WITH_FCL make no hull of FCL.
//
// The only call is GJKSolver_libccd::shapeIntersect on Convex. FCL's signed distance and planes
// abort the process for some poses. The call may throw, which counts as no result, and may return a
// zero normal. The call does not check its inputs, so poses must be finite.
#pragma once

#include <memory>
#include <optional>

#include "novaphy/collision/geometry/shape.h"

namespace novaphy::detail {

bool has_fcl();  // whether the build has NOVAPHY_WITH_FCL

// A hull in FCL's format: a copy of the tables, which must be in host memory.
class FclHull {
 public:
  explicit FclHull(const geometry::HullView& hull);
  ~FclHull();
  FclHull(FclHull&&) noexcept;

  struct Penetration {
    Vec3f normal;  // unit vector from the first hull to the second, not checked
    double depth;  // m
  };
  // Returns the penetration, or nothing if FCL finds no overlap or throws. `other_in_this` is the
  // pose of the second hull in the frame of the first.
  std::optional<Penetration> penetration(const FclHull& other,
                                         const Transformf& other_in_this) const;

 private:
  struct Impl;
  std::unique_ptr<const Impl> impl_;
};

}  // namespace novaphy::detail
