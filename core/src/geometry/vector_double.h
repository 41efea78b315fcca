// Vectors in double precision, for quantities that are computed once per mesh.
#pragma once

#include <cmath>

#include "novaphy/math/types.h"

namespace novaphy::detail {

using Vec3d = Vec3<double>;

inline Vec3d to_double(const Vec3f& v) { return {v.x, v.y, v.z}; }
inline Vec3f to_float(const Vec3d& v) {
  return {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)};
}
inline double norm(const Vec3d& v) { return std::sqrt(math::dot(v, v)); }
inline Vec3d unit(const Vec3d& v) {  // the zero vector stays zero
  const double l = norm(v);
  return l > 0.0 ? v * (1.0 / l) : Vec3d{};
}

}  // namespace novaphy::detail
