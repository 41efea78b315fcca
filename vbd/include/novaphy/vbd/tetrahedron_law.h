// A tetrahedron in VBD: stable Neo-Hookean elasticity, seen from its corner x with the others at
// x1, x2, x3.
//
// Law. Column c of the deformation gradient is f_c = sum_m (x_m - x) w_m,c, where w_m is the row of
// the inverse rest matrix that belongs to corner m. The corner itself has the weights m = -(w1 + w2
// + w3). With J = det F, its cofactors cof F, ln = lam + mu, alpha = 1 + mu/max(ln, 1e-6) - act, C
// = F^T F and its value Cn at the start of the step h:
//   E = V [ mu/2 (tr C - 3) + ln/2 (J - alpha)^2 ] + V kd/(2h) sum_pq (C_pq - Cn_pq)^2
//   f = -V [ mu F m + ln (J - alpha) cof F m ] - damping
//   H = V [ mu |m|^2 I + ln (cof F m)(cof F m)^T ] + damping's
// H is the exact second derivative of the elastic E, positive definite for every shape, inverted
// ones too, because J is linear in one corner. The damping's part is its Gauss-Newton one. Symbols:
// x (m), w (1/m), V = volume at rest (m^3), mu, lam (Pa), kd (Pa*s), act (1): activation, added to
// the relative volume.
//
// Source: Smith, de Goes, Kim (2018) without the logarithm, as Newton 1.8.0's SolverVBD has it
// (without activation).
// Smooth everywhere. Gradient: exact in x, w, V, mu, lam, kd, act, Cn.
#pragma once

#include "novaphy/math/matrix.h"
#include "novaphy/vbd/block_law.h"

namespace novaphy::vbd {

// Scaled by the volume at rest; alpha holds the activation.
template <class T>
struct TetrahedronLaw {
  T mu{}, ln{}, alpha{}, kd_by_h{};
};
template <class T>
TetrahedronLaw<T> tetrahedron_law(const T& volume, const T& mu, const T& lambda,
                                  const T& activation, const T& kd_by_h) {
  using math::max;
  const T ln = lambda + mu;
  return {volume * mu, volume * ln, (T(1.0f) + mu / max(ln, T(1e-6f))) - activation,
          volume * kd_by_h};
}

template <class T>
struct TetrahedronWeights {
  Vec3<T> w1{}, w2{}, w3{};
};

// C_pq for pq = 00, 11, 22, 01, 02, 12.
template <class T>
struct TetrahedronStrain {
  T c[6]{};
};

namespace tetrahedron_detail {

template <class T>
struct Columns {
  Vec3<T> f[3]{};
};
template <class T>
Columns<T> gradient(const Vec3<T>& x, const Vec3<T>& x1, const Vec3<T>& x2, const Vec3<T>& x3,
                    const TetrahedronWeights<T>& w) {
  const Vec3<T> e1 = x1 - x, e2 = x2 - x, e3 = x3 - x;
  return {{(e1 * w.w1.x + e2 * w.w2.x) + e3 * w.w3.x, (e1 * w.w1.y + e2 * w.w2.y) + e3 * w.w3.y,
           (e1 * w.w1.z + e2 * w.w2.z) + e3 * w.w3.z}};
}
template <class T>
TetrahedronStrain<T> strain(const Columns<T>& g) {
  using math::dot;
  return {{dot(g.f[0], g.f[0]), dot(g.f[1], g.f[1]), dot(g.f[2], g.f[2]), dot(g.f[0], g.f[1]),
           dot(g.f[0], g.f[2]), dot(g.f[1], g.f[2])}};
}

}  // namespace tetrahedron_detail

template <class T>
TetrahedronStrain<T> tetrahedron_strain(const Vec3<T>& x, const Vec3<T>& x1, const Vec3<T>& x2,
                                        const Vec3<T>& x3, const TetrahedronWeights<T>& w) {
  return tetrahedron_detail::strain(tetrahedron_detail::gradient(x, x1, x2, x3, w));
}

// `damped` false leaves the terms of kd out, which are 0 then.
template <class T>
Block<T> tetrahedron_block(const Vec3<T>& x, const Vec3<T>& x1, const Vec3<T>& x2,
                           const Vec3<T>& x3, const TetrahedronWeights<T>& weights,
                           const TetrahedronLaw<T>& law, const TetrahedronStrain<T>& start,
                           bool damped) {
  using namespace math;
  const auto g = tetrahedron_detail::gradient(x, x1, x2, x3, weights);
  const auto& f = g.f;
  const Vec3<T> m = -((weights.w1 + weights.w2) + weights.w3);
  const Vec3<T> c0 = cross(f[1], f[2]), c1 = cross(f[2], f[0]), c2 = cross(f[0], f[1]);
  const T s = law.ln * (dot(f[0], c0) - law.alpha);
  const Vec3<T> fm = (f[0] * m.x + f[1] * m.y) + f[2] * m.z;
  const Vec3<T> dj = (c0 * m.x + c1 * m.y) + c2 * m.z;
  Block<T> block;
  block.f = -(fm * law.mu + dj * s);
  add_identity(block, law.mu * dot(m, m));
  add_outer(block, law.ln, dj);
  if (!damped) return block;

  const TetrahedronStrain<T> c = tetrahedron_detail::strain(g);
  const T two = T(2.0f);
  const Vec3<T> e[6] = {f[0] * (two * m.x),      f[1] * (two * m.y),      f[2] * (two * m.z),
                        f[0] * m.y + f[1] * m.x, f[0] * m.z + f[2] * m.x, f[1] * m.z + f[2] * m.y};
  for (int k = 0; k < 6; ++k) {
    const T weight = k < 3 ? law.kd_by_h : two * law.kd_by_h;
    block.f = block.f - e[k] * (weight * (c.c[k] - start.c[k]));
    add_outer(block, weight, e[k]);
  }
  return block;
}

template <class T>
T tetrahedron_energy(const Vec3<T>& x, const Vec3<T>& x1, const Vec3<T>& x2, const Vec3<T>& x3,
                     const TetrahedronWeights<T>& weights, const TetrahedronLaw<T>& law,
                     const TetrahedronStrain<T>& start) {
  using namespace math;
  const auto g = tetrahedron_detail::gradient(x, x1, x2, x3, weights);
  const TetrahedronStrain<T> c = tetrahedron_detail::strain(g);
  const T stretch = dot(g.f[0], cross(g.f[1], g.f[2])) - law.alpha;
  T squares = T(0.0f);
  for (int k = 0; k < 6; ++k) {
    const T d = c.c[k] - start.c[k];
    squares = squares + (k < 3 ? d * d : T(2.0f) * (d * d));
  }
  return T(0.5f) *
         ((law.mu * (((c.c[0] + c.c[1]) + c.c[2]) - T(3.0f)) + (law.ln * stretch) * stretch) +
          law.kd_by_h * squares);
}

}  // namespace novaphy::vbd
