// A contact of two features of surfaces in VBD: a vertex and a triangle, or two edges.
//
// Law, for the corners x_a of the features, with weights w_a (geometry/nearest_weights.h). sum w x
// is the vector between the nearest points. The unit normal n points from the second feature to the
// first, d = n.(sum w x) is the gap, and r the contact radius. With t = r/2, k2 = t^2 k and d0 =
// min(1e-5 m, t/2) the potential E(d) has the derivatives
//   E' = -k (r - d) for t <= d < r,  -k2/d for d0 < d < t,  k2 (d - 2 d0)/d0^2 for d <= d0
//   E'' = k,  k2/d^2,  k2/d0^2
// The displacement of the features is u = sum w (x - xn), with xn at the start of the step h, and
// u_t = u - n (n.u). The force and stiffness of a corner are
//   f_a = w_a (-E' n - kd/h min(n.u, 0) n - c u_t)
//   H_a = w_a^2 ((E'' + [n.u < 0] kd/h) n n^T + c (I - n n^T))
// c is the friction stiffness of particle_contact_law.h, for the load -E' at the start of the
// iteration. The contact acts while d < r. Weights and normal are constant in an iteration.
//
// Two edges e1 and e2 have no defined normal if they are parallel. While s < 1 the law of two edges
// is therefore multiplied by (2 - s) s:
//   s = |e1 x e2|^2 / (1e-3 |e1|^2 |e2|^2), with the rest lengths in the denominator
//
// Symbols: x, xn, r, d (m), contact stiffness k (N/m), damping kd (N*s/m).
// Source: SolverVBD of Newton 1.8.0. The factor (2 - s) s is that of Li et al., "Incremental
// Potential Contact" (2020).
// Not smooth: E'' at d = r, and f where the damping begins.
// Gradient: none yet.
#pragma once

#include "novaphy/vbd/particle_contact_law.h"

namespace novaphy::vbd {

// The derivatives E' (N) and E'' (N/m) of the potential.
template <class T>
struct GapDerivatives {
  T first{}, second{};
};
template <class T>
GapDerivatives<T> gap_derivatives(const T& d, const T& r, const T& k) {
  using math::select, math::min, math::max;
  const T zero = T(0.0f), t = T(0.5f) * r, k2 = (t * t) * k, least = min(T(1e-5f), T(0.5f) * t);
  const T above = max(d, least);
  const auto acts = d < r, is_soft = d >= t, is_deep = d <= least;
  const T deep = (k2 / (least * least)) * (d - (least + least));
  const T first = select(is_soft, k * (d - r), select(is_deep, deep, -(k2 / above)));
  return {select(acts, first, zero), select(acts, select(is_soft, k, k2 / (above * above)), zero)};
}

// The force between two features, before the weights of the corners: the unit normal, the slip u_t
// (m), the force `along` the normal (N), its stiffness (N/m), and the friction stiffness c (N/m).
template <class T>
struct SurfaceForce {
  Vec3<T> normal{}, slip{};
  T along{}, stiffness{}, friction{};
};

// Returns a particle contact whose force at x is f_a and whose stiffness is `together` times H_a.
// `together` is the number of corners that have the color of the particle. These corners move at
// the same time, and each corner takes the other corners as fixed. The factor keeps their moves
// from adding up too far.
template <class T>
ParticleContact<T> corner_contact(const SurfaceForce<T>& s, const T& weight, const T& together,
                                  const Vec3<T>& x, const Vec3<T>& start, const T& eps) {
  using namespace math;
  const T zero = T(0.0f), one = T(1.0f), two = T(2.0f);
  const T squared = (weight * weight) * together;
  const auto acts = s.along > zero;
  ParticleContact<T> c;
  c.slip = eps;
  c.point = x;
  c.normal = select(weight < zero, s.normal * T(-1.0f), s.normal);
  c.ke = squared * s.stiffness;
  // A contact without force gets a negative overlap.
  c.radius = select(acts, (abs(weight) * s.along) / select(acts, c.ke, one), T(-1.0f));
  const Vec3<T> u = s.slip / (weight * together);
  c.travel = (x - start) - u;
  const T slip = length(u);
  const T shape = select(slip > eps, one / select(slip > eps, slip, one), (two - slip / eps) / eps);
  const T load = (c.ke * c.radius) * shape;
  c.mu = select(acts, (squared * s.friction) / select(acts, load, one), zero);
  return c;
}

}  // namespace novaphy::vbd
