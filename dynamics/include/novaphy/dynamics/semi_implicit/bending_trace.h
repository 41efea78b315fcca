// The forces of a bending edge: a rotational spring and damper between two triangles.
//
// Law, for the opposite vertices 1, 2 and the edge from 3 to 4 (math/hinge.h: normals n1, n2, unit
// vector e along the edge, angle theta):
//   d1 = -n1 |e|                              d2 = -n2 |e|
//   d3 = -n1 (x1-x4).e - n2 (x2-x4).e         d4 = -n1 (x3-x1).e - n2 (x3-x2).e
//   t  = -|e| (ke (theta - rest) + kd (d1.v1 + d2.v2 + d3.v3 + d4.v4))
//   vertex a gets the force d_a t
// Symbols:
//   x, v       position (m) and velocity (m/s) of the vertices, world frame
//   ke, kd     stiffness (N/m^2 per rad) and damping (N*s/m^4)
//   rest       angle without a force (rad)
//   results    N, world frame
// Source: the bending element of Bridson, Marino, Fedkiw, "Simulation of Clothing with Folds and
// Wrinkles" (2003), section 4, in the simplified form of Newton 1.8.0, SolverSemiImplicit. For ke =
// 0 the result has the same bits as Newton's on the CPU; otherwise atan2 differs by up to 1.6 ulp.
//
// For kd = 0 velocities are not read.
//
// The forces of a hinge sum to zero. Their moment is zero only if both triangles have the same
// height over the edge. The reason is that the directions d are not divided by the heights, unlike
// the gradient of theta.
//
// A border edge, which lacks an opposite vertex, has no force and no gradient. The same holds for a
// hinge with a triangle or edge smaller than 1e-6 (|n| in m^2, |e| in m). At a full fold theta
// jumps by 2 pi, and the force jumps too. Gradient: exact in x, v, ke, kd, rest elsewhere,
// including a straight hinge.
//
// Freestanding: T = float runs in the forward solver, T = nova::Real is traced.
#pragma once

#include "novaphy/math/hinge.h"

namespace novaphy {

// The forces of a bending edge on its vertices.
template <class T>
struct BendingForces {
  Vec3<T> f1{}, f2{}, f3{}, f4{};
};

// Returns the forces. `complete`: whether both opposite vertices exist; bool, or nova::Bool in a
// trace.
template <class B, class T>
BendingForces<T> bending_forces(const B& complete, const Vec3<T> (&x)[4], const Vec3<T> (&v)[4],
                                const T& stiffness, const T& damping, const T& rest_angle) {
  using namespace math;
  const T smallest = T(1.0e-6f);
  const Hinge<T> h = make_hinge(x[0], x[1], x[2], x[3]);
  const auto degenerate =
      either(either(h.n1_length < smallest, h.n2_length < smallest), h.e_length < smallest);
  const Vec3<T> d1 = (-h.n1) * h.e_length;
  const Vec3<T> d2 = (-h.n2) * h.e_length;
  const Vec3<T> d3 = (-h.n1) * dot(x[0] - x[3], h.e) - h.n2 * dot(x[1] - x[3], h.e);
  const Vec3<T> d4 = (-h.n1) * dot(x[2] - x[0], h.e) - h.n2 * dot(x[2] - x[1], h.e);
  const T elastic = stiffness * (h.angle - rest_angle);
  const T viscous =
      optional_product(damping, ((dot(d1, v[0]) + dot(d2, v[1])) + dot(d3, v[2])) + dot(d4, v[3]));
  const T t = (-h.e_length) * (elastic + viscous);
  const auto acts = both(complete, negate(degenerate));
  const T none = T(-0.0f);  // adding -0 changes no bit
  const Vec3<T> nothing = {none, none, none};
  return {select(acts, d1 * t, nothing), select(acts, d2 * t, nothing),
          select(acts, d3 * t, nothing), select(acts, d4 * t, nothing)};
}

}  // namespace novaphy
