// A tetrahedron in VBD: stable Neo-Hookean elasticity. The law is stated for the corner x, and the
// other corners are x1, x2, x3.
//
// Law. Column c of the deformation gradient F is f_c = sum_k (x_k - x) w_k,c, where w_k is the row
// of the inverse rest matrix that belongs to corner k. The corner x has the weights m = -(w1 + w2 +
// w3). J is det F, cof F are the cofactors of F, and ln = lam + mu. The rest value of J is alpha =
// 1 + mu/max(ln, 1e-6) - act. C = F^T F has the value Cn at the start of the step, and h is the
// step size:
//   E = V [ mu/2 (tr C - 3) + ln/2 (J - alpha)^2 ] + V kd/(2h) sum_pq (C_pq - Cn_pq)^2
//   f = -V [ mu F m + ln (J - alpha) cof F m ] - damping
//   H = V [ mu |m|^2 I + ln (cof F m)(cof F m)^T ] + damping's H
// The stiffness between the corners k and l has s = ln (J - alpha). The matrix [v] is defined by
// d.([v] e) = v.(d x e), and m_k are the weights of corner k:
//   H_kl = V [ mu m_k.m_l I + ln (cof F m_k)(cof F m_l)^T + s' [F (m_k x m_l)] ] + damping's H_kl
// s' is s, clamped so that H stays positive semidefinite: at least -min(mu/S, ln max(J, 0)), at
// most mu/(2 S). S is the largest stretch (singular value) of F. The code bounds S^2 by the largest
// row sum of |C|.
// H is the exact second derivative of the elastic E, because J is linear in the position of one
// corner. H is positive definite for every shape, also for an inverted one. For the damping H has
// the Gauss-Newton part.
//
// Symbols: x (m), w (1/m), V = rest volume (m^3), mu, lam (Pa), kd (Pa*s). act (1) is the
// activation, which is subtracted from alpha.
//
// Source: Smith, de Goes, Kim (2018) without the logarithm, as in SolverVBD of Newton 1.8.0, which
// has no activation.
// Smooth everywhere. Gradient: exact in x, w, V, mu, lam, kd, act, Cn.
#pragma once

#include "novaphy/math/matrix.h"
#include "novaphy/vbd/elements/element.h"

#define NOVAPHY_VBD_TETRAHEDRON_PARAMETERS(X) \
  X(particle_tet_pose, 9, 9, kRestShape)      \
  X(particle_tet_material, 3, 3, kMaterial)   \
  X(particle_tet_activation, 1, 1, kActivation)

namespace novaphy::vbd {

// The numbers of a slot: the weights w1, w2, w3; the coefficients V mu, V ln, alpha, V kd/h; the
// start values Cn00, Cn11, Cn22, Cn01, Cn02, Cn12.
struct Tetrahedron : ElementOf<4> {
  static constexpr int kWeights = 9, kLawFloats = 4, kStartFloats = 6;
  static constexpr int kDampingParameter = 11, kActivated = 11;
  NOVAPHY_VBD_ELEMENT(particle_tet_indices, NOVAPHY_VBD_TETRAHEDRON_PARAMETERS)
  template <class M>
  static auto& activation(M& m) {
    return m.particle_tet_activation;
  }

  template <class S>
  struct Columns {
    Vec3<S> f[3];
  };
  // Returns the columns of F from the positions of the corners, or the change of F from their
  // displacements.
  template <class S, class Numbers>
  static Columns<S> columns_of(const Vec3<S>& own, const Vec3<S>* others, const Numbers& n) {
    const Vec3<S> e1 = others[0] - own, e2 = others[1] - own, e3 = others[2] - own;
    return {{(e1 * n[0] + e2 * n[3]) + e3 * n[6], (e1 * n[1] + e2 * n[4]) + e3 * n[7],
             (e1 * n[2] + e2 * n[5]) + e3 * n[8]}};
  }
  template <class In>
  static auto columns(const In& in) {
    return columns_of(in.own, in.others, in.numbers);
  }
  // The components of C, in the order of the start values Cn.
  template <class S>
  struct Strain {
    S c[6];
  };
  template <class S>
  static Strain<S> strain(const Columns<S>& of) {
    using math::dot;
    const auto& f = of.f;
    return {{dot(f[0], f[0]), dot(f[1], f[1]), dot(f[2], f[2]), dot(f[0], f[1]), dot(f[0], f[2]),
             dot(f[1], f[2])}};
  }

  // If `damped` is false, the damping terms are left out. The caller guarantees that kd is 0.
  template <template <class> class B = Block, class In>
  static auto block(const In& in, bool damped) {
    using namespace math;
    using S = typename In::Scalar;
    const auto& n = in.numbers;
    const Columns<S> columns_of_f = columns(in);
    const auto& f = columns_of_f.f;
    const S mu = n[9], ln = n[10];
    const Vec3<S> m =
        -((Vec3<S>{n[0], n[1], n[2]} + Vec3<S>{n[3], n[4], n[5]}) + Vec3<S>{n[6], n[7], n[8]});
    const Vec3<S> c0 = cross(f[1], f[2]), c1 = cross(f[2], f[0]), c2 = cross(f[0], f[1]);
    const S s = ln * (dot(f[0], c0) - n[11]);
    const Vec3<S> fm = (f[0] * m.x + f[1] * m.y) + f[2] * m.z;
    const Vec3<S> dj = (c0 * m.x + c1 * m.y) + c2 * m.z;
    B<S> block;
    block.f = -(fm * mu + dj * s);
    add_identity(block, mu * dot(m, m));
    add_outer(block, ln, dj);
    if (!damped) return block;

    const Strain<S> now = strain(columns_of_f);
    const S kd_by_h = n[12], two = S(2.0f);
    const Vec3<S> e[6] = {f[0] * (two * m.x),      f[1] * (two * m.y),
                          f[2] * (two * m.z),      f[0] * m.y + f[1] * m.x,
                          f[0] * m.z + f[2] * m.x, f[1] * m.z + f[2] * m.y};
    for (int k = 0; k < 6; ++k) {
      const S weight = k < 3 ? kd_by_h : two * kd_by_h;
      block.f = block.f - e[k] * (weight * (now.c[k] - n[13 + k]));
      add_outer(block, weight, e[k]);
    }
    return block;
  }
  // Returns s', which is s clamped to its bounds.
  template <class S>
  static S bounded(const S& s, const S& mu, const S& ln, const S& j, const Strain<S>& strain) {
    using namespace math;
    const auto& c = strain.c;
    const S shear[3] = {max(c[3], -c[3]), max(c[4], -c[4]), max(c[5], -c[5])};
    const S squared = max((c[0] + shear[0]) + shear[1],
                          max((c[1] + shear[0]) + shear[2], (c[2] + shear[1]) + shear[2]));
    const S most = mu / sqrt(max(squared, S(1e-12f)));
    return max(min(s, S(0.5f) * most), -min(most, ln * max(j, S(0.0f))));
  }
  // Returns a function of displacements d that sums H_0k d_k over the corners k.
  template <class In>
  static auto stiffness(const In& in, bool damped) {
    using namespace math;
    using S = typename In::Scalar;
    using V = Vec3<S>;
    const auto n = in.numbers;
    const Columns<S> of = columns(in);
    const S mu = n[9], ln = n[10], kd2 = S(2.0f) * n[12];
    const V m = -((V{n[0], n[1], n[2]} + V{n[3], n[4], n[5]}) + V{n[6], n[7], n[8]});
    const V c0 = cross(of.f[1], of.f[2]), c1 = cross(of.f[2], of.f[0]);
    const V c2 = cross(of.f[0], of.f[1]);
    const S j = dot(of.f[0], c0);
    const S s = bounded(ln * (j - n[11]), mu, ln, j, strain(of));
    const V dj = (c0 * m.x + c1 * m.y) + c2 * m.z;
    return [=](const V* d) {
      const Columns<S> moved = columns_of(d[0], d + 1, n);
      const auto& f = of.f;
      const auto& g = moved.f;
      const S grown = (dot(c0, g[0]) + dot(c1, g[1])) + dot(c2, g[2]);
      V sum = ((g[0] * m.x + g[1] * m.y) + g[2] * m.z) * mu + dj * (ln * grown);
      const V turned =
          (cross(g[2] * m.y - g[1] * m.z, f[0]) + cross(g[0] * m.z - g[2] * m.x, f[1])) +
          cross(g[1] * m.x - g[0] * m.y, f[2]);
      sum = sum + turned * s;
      if (!damped) return sum;
      sum = sum + (f[0] * (m.x * dot(f[0], g[0])) + f[1] * (m.y * dot(f[1], g[1])) +
                   f[2] * (m.z * dot(f[2], g[2]))) *
                      (S(2.0f) * kd2);
      const auto add = [&](const V& fa, const V& fb, const S& ma, const S& mb, const V& ga,
                           const V& gb) {
        sum = sum + (fa * mb + fb * ma) * (kd2 * (dot(fa, gb) + dot(fb, ga)));
      };
      add(f[0], f[1], m.x, m.y, g[0], g[1]);
      add(f[0], f[2], m.x, m.z, g[0], g[2]);
      add(f[1], f[2], m.y, m.z, g[1], g[2]);
      return sum;
    };
  }
  template <class In>
  static auto energy(const In& in) {
    using namespace math;
    using S = typename In::Scalar;
    const auto& n = in.numbers;
    const Columns<S> of = columns(in);
    const auto [c] = strain(of);
    const S stretch = dot(of.f[0], cross(of.f[1], of.f[2])) - n[11];
    S squares = S(0.0f);
    for (int k = 0; k < 6; ++k) {
      const S d = c[k] - n[13 + k];
      squares = squares + (k < 3 ? d * d : S(2.0f) * (d * d));
    }
    return S(0.5f) * ((n[9] * (((c[0] + c[1]) + c[2]) - S(3.0f)) + (n[10] * stretch) * stretch) +
                      n[12] * squares);
  }
  template <class In, class Put>
  static void put_start(const In& in, const Put& put) {
    const auto of = strain(columns(in));
    for (int k = 0; k < 6; ++k) put(k, of.c[k]);
  }
  template <class T, class Put>
  static void put_numbers(int corner, const T* p, const T& h, const Put& put) {
    put_weights<3>(corner, p, put);
    const Mat33<T> pose = {{{p[0], p[1], p[2]}, {p[3], p[4], p[5]}, {p[6], p[7], p[8]}}};
    const T volume = T(1.0f) / (math::determinant(pose) * T(6.0f));
    put_neo_hookean(9, volume, p[9], p[10], p[12], p[11] / h, put);
  }
};

}  // namespace novaphy::vbd
