// The row type of the tables of a sweep: a vector of a particle, and a fourth number that few
// tables use.
#pragma once

#include "novaphy/math/types.h"

namespace novaphy {

struct alignas(16) VbdRow {
  using Element = Vec4f;  // the element type of arrays of this struct
  float x = 0.0f, y = 0.0f, z = 0.0f, w = 0.0f;
  VbdRow() = default;
  VbdRow(const Vec3f& v) : x(v.x), y(v.y), z(v.z) {}
  operator Vec3f() const { return {x, y, z}; }
};
inline Vec3f to_vec3(const VbdRow& row) { return row; }
inline VbdRow to_row(const Vec3f& v) { return v; }

namespace vbd {

// Returns the row of a particle that the adaptive guess of the next step reads: the velocity qd
// (m/s), and the number 1. A row of zeros means that the particle had no previous step.
inline VbdRow to_last_velocity(const Vec3f& qd) {
  VbdRow row(qd);
  row.w = 1.0f;
  return row;
}

}  // namespace vbd

}  // namespace novaphy
