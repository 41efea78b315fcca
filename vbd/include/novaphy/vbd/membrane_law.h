// A triangle in VBD: a stable Neo-Hookean membrane, seen from its corner x with the others at x1,
// x2.
//
// Law. Column c of the deformation gradient is f_c = (x1-x) w1_c + (x2-x) w2_c, c = 0, 1. The row
// of the inverse rest matrix that belongs to corner m is w_m, and the corner itself has the weights
// (a, b) = -(w1 + w2). Let J = sqrt(max(|f0 x f1|^2, 1e-20)), the normal n = (f0 x f1)/J, ln = lam
// + mu and alpha = 1 + mu/max(ln, 1e-6) - act. The right Cauchy-Green tensor is C = (f_p . f_q),
// with the value Cn at the start of the step h:
//   E = A [ mu/2 (|f0|^2 + |f1|^2 - 2) + ln/2 (J - alpha)^2 ]
//       + A kd/(2h) [ (C00 - Cn00)^2 + 2 (C01 - Cn01)^2 + (C11 - Cn11)^2 ]
//   s = ln (J - alpha), g0 = f1 x n, g1 = n x f0, P_c = mu f_c + s g_c
//   f = -A (P0 a + P1 b) - damping
//   H = A [ (mu (a^2 + b^2) + r w.w) I + (ln - r) dJ dJ^T - r w w^T ] + damping's
//   dJ = g0 a + g1 b, w = f1 a - f0 b, r = max(0, s)/J
// H is the second derivative of the elastic E where s >= 0 and positive semidefinite everywhere;
// the damping's part is its Gauss-Newton one. A rotation is not damped.
// Symbols: x (m), w (1/m), A = area at rest (m^2), mu, lam (N/m: ke and ka of
// particle_tri_material), kd (N*s/m), act (1): activation, added to the relative area.
//
// Source: Smith, de Goes, Kim (2018) in two dimensions, as Newton 1.8.0's SolverVBD has it (without
// activation).
// Not smooth: s = 0 in H; |f0 x f1| < 1e-10.
// Gradient: exact in x, w, A, mu, lam, kd, act, Cn away from these.
#pragma once

#include "novaphy/vbd/block_law.h"

namespace novaphy::vbd {

// Scaled by the area at rest; alpha holds the activation.
template <class T>
struct MembraneLaw {
  T mu{}, ln{}, alpha{}, kd_by_h{};
};
template <class T>
MembraneLaw<T> membrane_law(const T& area, const T& mu, const T& lambda, const T& activation,
                            const T& kd_by_h) {
  using math::max;
  const T ln = lambda + mu;
  return {area * mu, area * ln, (T(1.0f) + mu / max(ln, T(1e-6f))) - activation, area * kd_by_h};
}

template <class T>
struct MembraneWeights {
  Vec2<T> w1{}, w2{};
};

template <class T>
struct MembraneStrain {
  T c00{}, c01{}, c11{};
};

namespace membrane_detail {

template <class T>
struct Shape {
  Vec3<T> f0{}, f1{}, normal{};
  T area_ratio{};
};

template <class T>
Vec3<T> gradient_column(const Vec3<T>& e1, const Vec3<T>& e2, const T& w1, const T& w2) {
  return e1 * w1 + e2 * w2;
}

template <class T>
Shape<T> shape(const Vec3<T>& x, const Vec3<T>& x1, const Vec3<T>& x2,
               const MembraneWeights<T>& w) {
  using math::max, math::sqrt;
  const Vec3<T> e1 = x1 - x, e2 = x2 - x;
  Shape<T> s;
  s.f0 = gradient_column(e1, e2, w.w1.x, w.w2.x);
  s.f1 = gradient_column(e1, e2, w.w1.y, w.w2.y);
  const Vec3<T> m = math::cross(s.f0, s.f1);
  s.area_ratio = sqrt(max(math::dot(m, m), T(1e-20f)));
  s.normal = m / s.area_ratio;
  return s;
}

template <class T>
MembraneStrain<T> strain(const Vec3<T>& f0, const Vec3<T>& f1) {
  return {math::dot(f0, f0), math::dot(f0, f1), math::dot(f1, f1)};
}

}  // namespace membrane_detail

template <class T>
MembraneStrain<T> membrane_strain(const Vec3<T>& x, const Vec3<T>& x1, const Vec3<T>& x2,
                                  const MembraneWeights<T>& w) {
  const Vec3<T> e1 = x1 - x, e2 = x2 - x;
  return membrane_detail::strain(membrane_detail::gradient_column(e1, e2, w.w1.x, w.w2.x),
                                 membrane_detail::gradient_column(e1, e2, w.w1.y, w.w2.y));
}

// `damped` false leaves the terms of kd out, which are 0 then.
template <class T>
Block<T> membrane_block(const Vec3<T>& x, const Vec3<T>& x1, const Vec3<T>& x2,
                        const MembraneWeights<T>& weights, const MembraneLaw<T>& law,
                        const MembraneStrain<T>& start, bool damped) {
  using namespace math;
  const auto [f0, f1, n, j] = membrane_detail::shape(x, x1, x2, weights);
  const T a = -(weights.w1.x + weights.w2.x), b = -(weights.w1.y + weights.w2.y);
  const T zero = T(0.0f), two = T(2.0f);
  const T s = law.ln * (j - law.alpha);
  const Vec3<T> dj = cross(f1, n) * a + cross(n, f0) * b;
  const Vec3<T> w = f1 * a - f0 * b;
  const T r = max(zero, s) / j;
  Block<T> block;
  block.f = -((f0 * a + f1 * b) * law.mu + dj * s);
  add_identity(block, law.mu * (a * a + b * b) + r * dot(w, w));
  add_outer(block, law.ln - r, dj);
  add_outer(block, -r, w);
  if (!damped) return block;

  const MembraneStrain<T> c = membrane_detail::strain(f0, f1);
  const Vec3<T> e00 = f0 * (two * a), e01 = f1 * a + f0 * b, e11 = f1 * (two * b);
  const T k = law.kd_by_h, k2 = two * k;
  block.f = block.f - ((e00 * (k * (c.c00 - start.c00)) + e01 * (k2 * (c.c01 - start.c01))) +
                       e11 * (k * (c.c11 - start.c11)));
  add_outer(block, k, e00);
  add_outer(block, k2, e01);
  add_outer(block, k, e11);
  return block;
}

template <class T>
T membrane_energy(const Vec3<T>& x, const Vec3<T>& x1, const Vec3<T>& x2,
                  const MembraneWeights<T>& weights, const MembraneLaw<T>& law,
                  const MembraneStrain<T>& start) {
  const auto shape = membrane_detail::shape(x, x1, x2, weights);
  const MembraneStrain<T> c = membrane_detail::strain(shape.f0, shape.f1);
  const T stretch = shape.area_ratio - law.alpha;
  const T d00 = c.c00 - start.c00, d01 = c.c01 - start.c01, d11 = c.c11 - start.c11;
  return T(0.5f) * ((law.mu * ((c.c00 + c.c11) - T(2.0f)) + (law.ln * stretch) * stretch) +
                    law.kd_by_h * ((d00 * d00 + T(2.0f) * (d01 * d01)) + d11 * d11));
}

}  // namespace novaphy::vbd
