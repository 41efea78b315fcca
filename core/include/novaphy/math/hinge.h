// The geometry of a hinge: two triangles with a common edge. The builder measures rest angles with
// the same function as the bending force, so a hinge at its rest angle has exactly no force.
#pragma once

#include "novaphy/math/functions.h"
#include "novaphy/math/types.h"

namespace novaphy::math {

template <class T>
struct Hinge {
  Vec3<T> n1{}, n2{}, e{};  // unit normals of the triangles, unit vector along the edge
  T n1_length{}, n2_length{}, e_length{};  // twice the triangles' areas (m^2), the edge's length
                                           // (m)
  T angle{};                               // rad
};

// Returns directions and the angle, which are undefined if a length is 0. Check the lengths first.
template <class T>
Hinge<T> make_hinge(const Vec3<T>& x1, const Vec3<T>& x2, const Vec3<T>& x3, const Vec3<T>& x4) {
  Hinge<T> h;
  const Vec3<T> n1 = cross(x3 - x1, x4 - x1);
  const Vec3<T> n2 = cross(x4 - x2, x3 - x2);
  const Vec3<T> e = x4 - x3;
  h.n1_length = length(n1);
  h.n2_length = length(n2);
  h.e_length = length(e);
  h.n1 = n1 / h.n1_length;
  h.n2 = n2 / h.n2_length;
  h.e = e / h.e_length;
  const T cosine = dot(h.n1, h.n2);
  const T sine = dot(cross(h.n1, h.n2), h.e);
  h.angle = atan2(sine, cosine);
  return h;
}

}  // namespace novaphy::math
