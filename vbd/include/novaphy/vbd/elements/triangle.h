// A triangle in VBD: a stable Neo-Hookean membrane. The law is stated for the corner x, and the
// other corners are x1, x2.
//
// Law. Column c of the deformation gradient F is f_c = (x1-x) w1_c + (x2-x) w2_c, c = 0, 1. w_m is
// the row of the inverse rest matrix that belongs to corner m. The corner x has the weights (a, b)
// = -(w1 + w2). J = sqrt(max(|f0 x f1|^2, 1e-20)) is the area ratio, and n = (f0 x f1)/J the
// normal. With ln = lam + mu the rest value of J is alpha = 1 + mu/max(ln, 1e-6) - act.
//
// C = (f_p . f_q) is the right Cauchy-Green tensor, and Cn its value at the start of the step. The
// step size is h:
//   E = A [ mu/2 (|f0|^2 + |f1|^2 - 2) + ln/2 (J - alpha)^2 ]
//       + A kd/(2h) [ (C00 - Cn00)^2 + 2 (C01 - Cn01)^2 + (C11 - Cn11)^2 ]
//   s = ln (J - alpha), g0 = f1 x n, g1 = n x f0, P_c = mu f_c + s g_c
//   f = -A (P0 a + P1 b) - damping
//   H = A [ (mu (a^2 + b^2) + r w.w) I + (ln - r) dJ dJ^T - r w w^T ] + damping's H
//   dJ = g0 a + g1 b, w = f1 a - f0 b, r = max(0, s)/J
// H is the second derivative of the elastic E where s >= 0, and positive semidefinite everywhere.
// For the damping H has the Gauss-Newton part. Rotations are not damped.
// The stiffness between the corners k and l has w_k = f1 a_k - f0 b_k. The matrix [v] is defined by
// d.([v] e) = v.(d x e):
//   H_kl = A [ mu (a_k a_l + b_k b_l) I + ln dJ_k dJ_l^T + max(s/J, -mu/S^2) (w_k.w_l) n n^T
//              + clamp(s, -mu, mu) (a_k b_l - a_l b_k) [n] ] + damping's H_kl
// S is the larger stretch (singular value) of F. At the bounds of max and clamp an eigenvalue is 0.
// Symbols: x (m), w (1/m), A = rest area (m^2), mu, lam (N/m: ke and ka of
// particle_tri_material), kd (N*s/m). act (1) is the activation, which is subtracted from alpha.
//
// Source: Smith, de Goes, Kim (2018) in two dimensions, as in SolverVBD of Newton 1.8.0, which has
// no activation.
// Not smooth: s = 0 in H; |f0 x f1| < 1e-10.
// Gradient: exact in x, w, A, mu, lam, kd, act and Cn, except where the law is not smooth.
#pragma once

#include "novaphy/vbd/elements/element.h"

#define NOVAPHY_VBD_TRIANGLE_PARAMETERS(X)  \
  X(particle_tri_pose, 4, 4, kRestShape)    \
  X(particle_tri_area, 1, 1, kRestLength)   \
  X(particle_tri_material, 3, 5, kMaterial) \
  X(particle_tri_activation, 1, 1, kActivation)

namespace novaphy::vbd {

// The numbers of a slot: the weights w1, w2; the coefficients A mu, A ln, alpha, A kd/h; the start
// values Cn00, Cn01, Cn11.
struct Triangle : ElementOf<3> {
  static constexpr int kWeights = 4, kLawFloats = 4, kStartFloats = 3;
  static constexpr int kDampingParameter = 7, kActivated = 6;
  static constexpr bool kResistsTurns = true;
  static constexpr const char* kUnread = "drag and lift";
  NOVAPHY_VBD_ELEMENT(particle_tri_indices, NOVAPHY_VBD_TRIANGLE_PARAMETERS)
  template <class M>
  static auto& activation(M& m) {
    return m.particle_tri_activation;
  }

  template <class S>
  struct Columns {
    Vec3<S> f0, f1;
  };
  template <class In>
  static auto column(const In& in, int c) {
    const auto e1 = in.others[0] - in.own, e2 = in.others[1] - in.own;
    return e1 * in.numbers[c] + e2 * in.numbers[2 + c];
  }
  template <class In>
  static auto columns(const In& in) {
    return Columns<typename In::Scalar>{column(in, 0), column(in, 1)};
  }
  template <class S>
  struct Strain {
    S c00, c01, c11;
  };
  template <class S>
  static Strain<S> strain(const Columns<S>& f) {
    return {math::dot(f.f0, f.f0), math::dot(f.f0, f.f1), math::dot(f.f1, f.f1)};
  }
  // Returns the area ratio J from the vector f0 x f1.
  template <class S>
  static S area_ratio(const Vec3<S>& normal) {
    using math::max, math::sqrt;
    return sqrt(max(math::dot(normal, normal), S(1e-20f)));
  }

  // Returns the stiffness normal to the membrane, divided by (w_k.w_l): max(s/J, -mu/S^2).
  template <class S>
  static S across(const Columns<S>& f, const S& s_by_j, const S& mu) {
    using math::max, math::sqrt;
    const auto [c00, c01, c11] = strain(f);
    const S half = S(0.5f), apart = half * (c00 - c11);
    const S largest = half * (c00 + c11) + sqrt(apart * apart + c01 * c01);
    return max(s_by_j, -(mu / max(largest, S(1e-20f))));
  }

  // If `damped` is false, the damping terms are left out. The caller guarantees that kd is 0. If
  // `turns` is true, H is the stiffness H_00 of stiffness(), with r = max(s/J, -mu/S^2).
  template <template <class> class B = Block, class In>
  static auto block(const In& in, bool damped, bool turns = false) {
    using namespace math;
    using S = typename In::Scalar;
    const auto& numbers = in.numbers;
    const S mu = numbers[4], ln = numbers[5];
    const Columns<S> c = columns(in);
    const auto& [f0, f1] = c;
    const Vec3<S> m = cross(f0, f1);
    const S j = area_ratio(m);
    const Vec3<S> n = m / j;
    const S a = -(numbers[0] + numbers[2]), b = -(numbers[1] + numbers[3]);
    const S zero = S(0.0f), two = S(2.0f);
    const S s = ln * (j - numbers[6]);
    const Vec3<S> dj = cross(f1, n) * a + cross(n, f0) * b;
    const Vec3<S> w = f1 * a - f0 * b;
    const S r = turns ? across(c, s / j, mu) : max(zero, s) / j;
    B<S> block;
    block.f = -((f0 * a + f1 * b) * mu + dj * s);
    add_identity(block, mu * (a * a + b * b) + r * dot(w, w));
    add_outer(block, ln - r, dj);
    add_outer(block, -r, w);
    if (!damped) return block;

    const auto [c00, c01, c11] = strain(c);
    const Vec3<S> e00 = f0 * (two * a), e01 = f1 * a + f0 * b, e11 = f1 * (two * b);
    const S k = numbers[7], k2 = two * k;
    block.f = block.f - ((e00 * (k * (c00 - numbers[8])) + e01 * (k2 * (c01 - numbers[9]))) +
                         e11 * (k * (c11 - numbers[10])));
    add_outer(block, k, e00);
    add_outer(block, k2, e01);
    add_outer(block, k, e11);
    return block;
  }
  // Returns a function of displacements d that sums H_0k d_k over the corners k.
  template <class In>
  static auto stiffness(const In& in, bool damped) {
    using namespace math;
    using S = typename In::Scalar;
    using V = Vec3<S>;
    const auto& numbers = in.numbers;
    const S w0 = numbers[0], w1 = numbers[1], w2 = numbers[2], w3 = numbers[3];
    const S mu = numbers[4], ln = numbers[5], two = S(2.0f);
    const Columns<S> c = columns(in);
    const V f0 = c.f0, f1 = c.f1, m = cross(f0, f1);
    const S j = area_ratio(m);
    const V n = m / j, g0 = cross(f1, n), g1 = cross(n, f0);
    const S a = -(w0 + w2), b = -(w1 + w3);
    const S s = ln * (j - numbers[6]);
    const S tension = across(c, s / j, mu);
    const S within = max(min(s, mu), -mu);
    const V w = f1 * a - f0 * b, dj = g0 * a + g1 * b, shear = f1 * a + f0 * b;
    const S w_f0 = dot(w, f0), w_f1 = dot(w, f1), kd2 = two * numbers[7];
    return [=](const V* d) {
      const V e1 = d[1] - d[0], e2 = d[2] - d[0];
      const V d0 = e1 * w0 + e2 * w2, d1 = e1 * w1 + e2 * w3;
      V sum = (d0 * a + d1 * b) * mu + dj * (ln * (dot(g0, d0) + dot(g1, d1)));
      sum = sum + n * (tension * (w_f1 * dot(n, d0) - w_f0 * dot(n, d1)));
      sum = sum + cross(d1 * a - d0 * b, n) * within;
      if (!damped) return sum;
      sum = sum + f0 * (((kd2 * two) * a) * dot(f0, d0)) + f1 * (((kd2 * two) * b) * dot(f1, d1));
      return sum + shear * (kd2 * (dot(f1, d0) + dot(f0, d1)));
    };
  }
  template <class In>
  static auto energy(const In& in) {
    using S = typename In::Scalar;
    const auto& n = in.numbers;
    const Columns<S> c = columns(in);
    const S stretch = area_ratio(math::cross(c.f0, c.f1)) - n[6];
    const auto [c00, c01, c11] = strain(c);
    const S d00 = c00 - n[8], d01 = c01 - n[9], d11 = c11 - n[10];
    return S(0.5f) * ((n[4] * ((c00 + c11) - S(2.0f)) + (n[5] * stretch) * stretch) +
                      n[7] * ((d00 * d00 + S(2.0f) * (d01 * d01)) + d11 * d11));
  }
  template <class In, class Put>
  static void put_start(const In& in, const Put& put) {
    using S = typename In::Scalar;
    // Computed before the strain, because derivatives follow the order of the operations.
    const Vec3<S> f1 = column(in, 1);
    const auto [c00, c01, c11] = strain(Columns<S>{column(in, 0), f1});
    put(0, c00);
    put(1, c01);
    put(2, c11);
  }
  template <class T, class Put>
  static void put_numbers(int corner, const T* p, const T& h, const Put& put) {
    put_weights<2>(corner, p, put);
    put_neo_hookean(4, p[4], p[5], p[6], p[8], p[7] / h, put);
  }
};

}  // namespace novaphy::vbd
