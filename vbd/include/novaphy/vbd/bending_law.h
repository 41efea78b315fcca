// A bending edge in VBD: a rotational spring and damper between two triangles.
//
// Law, for the opposite vertices 0, 1 and the edge from 2 to 3. The header math/hinge.h gives the
// unit normals n1, n2 of lengths N1, N2, the unit vector e along the edge, and the angle th. The
// angle at the start of the step h is thn, and wrap(.) goes into (-pi, pi] by one turn:
//   E = ke L/2 (th - rest)^2 + kd L/(2h) wrap(th - thn)^2
//   f = -(ke L (th - rest) + kd L/h wrap(th - thn)) t,  H = (ke + kd/h) L t t^T,  t = dth/dx
//   dth/dx0 = -n1 |e|/N1                      dth/dx2 = n1 ((x3-x0).e)/N1 + n2 ((x3-x1).e)/N2
// The vertices 1 and 3 are 0 and 2 of the same edge read from its other side. H is the Gauss-Newton
// part of the second derivative: rank 1, positive semidefinite. No force where a length is < 1e-6.
// Symbols: x (m), L = length of the edge at rest (m), ke (N/m^2 per rad), kd (N*s/m^4), angles rad.
//
// Source: the closed form of Bridson, Marino, Fedkiw (2003) and Tamstorf, Grinspun (2013); Newton
// 1.8.0's SolverVBD has the same law. (The semi-implicit solver multiplies ke by the present length
// of the edge instead.)
// Not smooth: a full fold, where th jumps by a turn; lengths of 1e-6.
// Gradient: exact in x, ke, kd, L, rest, thn away from these.
#pragma once

#include "novaphy/math/hinge.h"
#include "novaphy/vbd/block_law.h"

namespace novaphy::vbd {

// Scaled by the length at rest.
template <class T>
struct BendingLaw {
  T ke{}, kd_by_h{}, rest{};
};

template <class T>
T bending_angle(const Vec3<T>& x0, const Vec3<T>& x1, const Vec3<T>& x2, const Vec3<T>& x3) {
  return math::make_hinge(x0, x1, x2, x3).angle;
}

namespace bending_detail {

template <class T>
auto is_hinge(const math::Hinge<T>& h) {
  using math::both;
  const T smallest = T(1e-6f);
  return both(h.n1_length >= smallest, both(h.n2_length >= smallest, h.e_length >= smallest));
}
template <class T>
T wrapped(const T& angle) {
  using math::select;
  const T pi = T(0x1.921fb6p+1f), turn = T(0x1.921fb6p+2f);
  return select(angle > pi, angle - turn, select(angle < -pi, angle + turn, angle));
}

template <class T>
Block<T> block_of(const math::Hinge<T>& h, const Vec3<T>& t, const BendingLaw<T>& law,
                  const T& start_angle) {
  const T moment = law.ke * (h.angle - law.rest) + law.kd_by_h * wrapped(h.angle - start_angle);
  Block<T> block;
  block.f = t * (-moment);
  add_outer(block, law.ke + law.kd_by_h, t);
  return where(is_hinge(h), block);
}

}  // namespace bending_detail

// Of the opposite vertex x0.
template <class T>
Block<T> bending_opposite_block(const Vec3<T>& x0, const Vec3<T>& x1, const Vec3<T>& x2,
                                const Vec3<T>& x3, const BendingLaw<T>& law, const T& start_angle) {
  const math::Hinge<T> h = math::make_hinge(x0, x1, x2, x3);
  return bending_detail::block_of(h, h.n1 * (-(h.e_length / h.n1_length)), law, start_angle);
}

// Of the end x2 of the edge.
template <class T>
Block<T> bending_end_block(const Vec3<T>& x0, const Vec3<T>& x1, const Vec3<T>& x2,
                           const Vec3<T>& x3, const BendingLaw<T>& law, const T& start_angle) {
  const math::Hinge<T> h = math::make_hinge(x0, x1, x2, x3);
  const Vec3<T> t = h.n1 * (math::dot(x3 - x0, h.e) / h.n1_length) +
                    h.n2 * (math::dot(x3 - x1, h.e) / h.n2_length);
  return bending_detail::block_of(h, t, law, start_angle);
}

template <class T>
T bending_energy(const Vec3<T>& x0, const Vec3<T>& x1, const Vec3<T>& x2, const Vec3<T>& x3,
                 const BendingLaw<T>& law, const T& start_angle) {
  using math::select;
  const math::Hinge<T> h = math::make_hinge(x0, x1, x2, x3);
  const T bent = h.angle - law.rest, moved = bending_detail::wrapped(h.angle - start_angle);
  const T energy = T(0.5f) * ((law.ke * bent) * bent + (law.kd_by_h * moved) * moved);
  return select(bending_detail::is_hinge(h), energy, T(0.0f));
}

}  // namespace novaphy::vbd
