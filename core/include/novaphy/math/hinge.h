// Two triangles that share an edge, and the angle between them.
//
//         x1           The triangles are (x1, x3, x4) and (x2, x4, x3); the edge runs from x3 to
//         x4.
//        /  \          The angle is 0 where they lie flat side by side, and signed: with the
//      x3 -- x4        normals n1 and n2 and the unit vector e along the edge it is
//        \  /            atan2(dot(cross(n1, n2), e), dot(n1, n2))  in [-pi, pi].
//         x2           At a full fold it jumps from pi to -pi.
//
// The builder measures rest angles with the very function that the bending force uses: a hinge at
// rest has no force, to the bit.
#pragma once

#include "novaphy/math/functions.h"
#include "novaphy/math/types.h"

namespace novaphy::math {

template <class T>
struct Hinge {
  Vec3<T> n1{}, n2{}, e{};  // unit normals of the triangles, unit vector along the edge
  T n1_length{}, n2_length{}, e_length{};  // twice the areas (m^2), the edge's length (m)
  T angle{};                               // rad
};

// Undefined directions (and angle) where a length is 0: ask before they are used.
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
