// The forces of a tetrahedral element: stable Neo-Hookean elasticity with damping.
//
// Law, for corners 0..3 at x with velocities v, rest matrix inverse Dm:
//   V  = 1/(6 det Dm)                                  volume at rest
//   F  = (x1-x0, x2-x0, x3-x0) Dm,  G = (v1-v0, v2-v0, v3-v0) Dm     deformation gradient, its rate
//   P  = V (mu F (1 - 1/(Ic + 1)) + damp G),  Ic = tr(F^T F)
//   (f1, f2, f3) = P Dm^T                              deviatoric part
//   J  = det F,  d_a = dJ/dx_a,  alpha = 1 + mu/lam - mu/(4 lam)
//   f_a += d_a V (lam (J - alpha + act) + damp (d1.v1 + d2.v2 + d3.v3))       volumetric part
//   corner a gets -f_a (a = 1..3), corner 0 the opposite of their sum
// Symbols:
//   x, v       position (m) and velocity (m/s) of the corners, world frame
//   Dm         inverse of the matrix of rest edges x_a - x_0 as columns (1/m)
//   mu, lam    coefficients (Pa), damp (Pa*s): the columns of particle_tet_material, where
//              particle_tet_is_lame is 0
//   act        activation, added to the relative volume (1)
//   results    N, world frame
// alpha makes the rest shape free of force: at F = 1 the deviatoric stress is 3/4 mu and the
// volumetric stress is -3/4 mu.
//
// For small strains the shear modulus is 3/4 mu and the first Lame parameter lam - 5/8 mu. Where
// particle_tet_is_lame is 1, the columns are the Lame parameters mu_L and lam_L. The law then has
//   mu = 4/3 mu_L,  lam = lam_L + 5/6 mu_L
//
// lam = 0 switches the volumetric stiffness off. Its part of the force, and the derivative by lam,
// are exactly 0 (alpha is not computed). The deviatoric part and the damping remain. Newton divides
// 0 by 0 there. With mu = lam = damp = 0 there is no force.
//
// If damp = 0, the velocities are not read.
//
// The velocities in the volumetric damping are those of the corners in the world, not relative to
// corner 0, as in Newton. With damp > 0, a pure translation therefore causes forces on the corners.
// Their sum is zero.
//
// Source: Smith, de Goes, Kim, "Stable Neo-Hookean Flesh Simulation" (2018), equations 13 and 18,
// as Newton 1.8.0's SolverSemiImplicit evaluates it. Without damping the bits are those of Newton
// on the CPU. Matrix products are chains of fused multiply-adds, see math/matrix.h.
//
// The force is smooth for flat and inverted tetrahedra too. The gradient is exact in x, v, act, mu,
// lam and damp (for lam = 0 see above). Dm has no gradient.
//
// Freestanding: T = float runs in the forward solver, T = nova::Real is traced.
#pragma once

#include "novaphy/math/matrix.h"

namespace novaphy {

template <class T>
struct TetrahedronMaterial {
  T mu{}, lambda{}, damping{};
};

// Returns the coefficients of the law. `is_lame`: the material has Lame parameters.
template <class Flag, class T>
TetrahedronMaterial<T> coefficients_of(const Flag& is_lame, const TetrahedronMaterial<T>& of) {
  using namespace math;
  return {select(is_lame, of.mu * T(4.0f / 3.0f), of.mu),
          select(is_lame, of.lambda + of.mu * T(5.0f / 6.0f), of.lambda), of.damping};
}

// The forces of a tetrahedron on its corners.
template <class T>
struct TetrahedronForces {
  Vec3<T> f0{}, f1{}, f2{}, f3{};
};

template <class T>
TetrahedronForces<T> tetrahedron_forces(const Vec3<T> (&x)[4], const Vec3<T> (&v)[4],
                                        const Mat33<T>& pose, const T& activation,
                                        const TetrahedronMaterial<T>& material) {
  using namespace math;
  const T one = T(1.0f), zero = T(0.0f), six = T(6.0f);
  const Vec3<T> x10 = x[1] - x[0], x20 = x[2] - x[0], x30 = x[3] - x[0];
  const Vec3<T> v10 = v[1] - v[0], v20 = v[2] - v[0], v30 = v[3] - v[0];
  const T inverse_volume = determinant(pose) * six;
  const T volume = one / inverse_volume;
  const T alpha = (one + material.mu / material.lambda) - material.mu / (T(4.0f) * material.lambda);
  const T mu = material.mu * volume;
  const T lambda = material.lambda * volume;
  const T damping = material.damping * volume;

  const Mat33<T> f = multiply(from_columns(x10, x20, x30), pose);
  Mat33<T> damped = multiply(from_columns(v10, v20, v30), pose);
  for (auto& row : damped.m)
    for (T& rate : row) rate = optional_product(damping, rate);
  const Vec3<T> c1 = column(f, 0), c2 = column(f, 1), c3 = column(f, 2);
  const T trace = (dot(c1, c1) + dot(c2, c2)) + dot(c3, c3);
  const Mat33<T> stress = add(scale(scale(f, mu), one - one / (trace + one)), damped);
  const Mat33<T> h = multiply(stress, transpose(pose));

  const T s = inverse_volume / six;
  const Vec3<T> d1 = cross(x20, x30) * s;
  const Vec3<T> d2 = cross(x30, x10) * s;
  const Vec3<T> d3 = cross(x10, x20) * s;
  const T elastic =
      select(material.lambda == zero, zero, ((determinant(f) - alpha) + activation) * lambda);
  const T viscous = optional_product(damping, (dot(d1, v[1]) + dot(d2, v[2])) + dot(d3, v[3]));
  const T t = elastic + viscous;

  const Vec3<T> f1 = column(h, 0) + d1 * t;
  const Vec3<T> f2 = column(h, 1) + d2 * t;
  const Vec3<T> f3 = column(h, 2) + d3 * t;
  return {(f1 + f2) + f3, -f1, -f2, -f3};
}

}  // namespace novaphy
