// The forces of a triangle: membrane and area elasticity, damping, drag and lift of the air.
//
// Law, for corners 0..2 at x with velocities v, rest matrix inverse Dm (2x2):
//   A0 = 1/(2 det Dm)                                      area at rest
//   F  = (x1-x0, x2-x0) Dm,  G = (v1-v0, v2-v0) Dm         deformation gradient (3x2), its rate
//   P  = A0 (ke F + kd G),  (f1, f2) = P Dm^T              membrane
//   A  = |cross(x1-x0, x2-x0)|/2,  n = unit normal
//   dq = dA/dx1 / A0,  dr = dA/dx2 / A0,  alpha = 1 + ke/ka
//   h  = A0 (ka (A/A0 - alpha + act) + kd (dq.v1 + dr.v2 - (dq + dr).v0))
//   f1 += dq h,  f2 += dr h,  where ka > 0                  area
//   vm = mean velocity of the corners, s = n . unit(vm)
//   D  = drag A |n . vm| vm                                each corner gets -D
//   L  = lift A asin(s) |vm|^2 n                           each corner gets -L
//   corner 0 gets f1 + f2 - D - L, corners 1 and 2 get -f1 - D - L and -f2 - D - L
// Symbols:
//   x, v              position (m) and velocity (m/s) of the corners, world frame
//   Dm                inverse of the rest edges as columns, in the triangle's plane (1/m)
//   ke, ka, kd        N/m, N/m, N*s/m; drag, lift N*s^2/m^4: the columns of particle_tri_material
//   act               activation, added to the relative area (1)
//   results           N, world frame
// The mean velocity is the sum times 0.3333, not a third; asin(s) is pi/2 - acos(s).
//
// Source: Newton 1.8.0, SolverSemiImplicit. The bits are those of Newton on the CPU wherever lift =
// 0 (acos differs by up to 1.2 ulp). The membrane is the energy of Smith, de Goes, Kim (2018) in
// two dimensions without its volume terms.
//
// Points where the law is not smooth, and the values there:
//   A = 0         no normal: n = 0, no area force, drag or lift, and no gradient through n and A.
//   vm = 0        drag and lift are 0, and so are their derivatives.
//   n . vm = 0    |.| has derivative +1 at 0; the factor makes drag smooth in the direction of vm.
//   s = +-1       acos has no gradient: the lift's direction is taken as constant there.
//   ka = 0        the area force is off. ka < 0 counts as 0.
// Gradient: exact in x, v, act and all columns of the material away from these points. Dm has no
// gradient.
//
// Freestanding: T = float runs in the forward solver, T = nova::Real is traced.
#pragma once

#include "novaphy/math/functions.h"
#include "novaphy/math/matrix.h"

namespace novaphy {

template <class T>
struct TriangleMaterial {
  T ke{}, ka{}, kd{}, drag{}, lift{};
};

// The forces of a triangle on its corners.
template <class T>
struct TriangleForces {
  Vec3<T> f0{}, f1{}, f2{};
};

namespace triangle_detail {

template <class T>
struct Edges {
  Vec3<T> f1{}, f2{};
};

// Adds the area force and its damping to the membrane forces.
template <class T>
Edges<T> add_area_force(const Edges<T>& membrane, const Vec3<T>& x10, const Vec3<T>& x20,
                        const Vec3<T> (&v)[3], const Vec3<T>& normal, const T& area,
                        const T& inverse_area, const T& activation,
                        const TriangleMaterial<T>& scaled) {
  using namespace math;
  const T half = T(0.5f);
  const T alpha = T(1.0f) + scaled.ke / scaled.ka;
  const T c = ((area * inverse_area) - alpha) + activation;
  const Vec3<T> dq = (cross(x20, normal) * inverse_area) * half;
  const Vec3<T> dr = (cross(normal, x10) * inverse_area) * half;
  const T rate = (dot(dq, v[1]) + dot(dr, v[2])) - dot(dq + dr, v[0]);
  const T h = scaled.ka * c + scaled.kd * rate;
  const auto acts = scaled.ka > T(0.0f);
  return {select(acts, membrane.f1 + dq * h, membrane.f1),
          select(acts, membrane.f2 + dr * h, membrane.f2)};
}

}  // namespace triangle_detail

template <class T>
TriangleForces<T> triangle_forces(const Vec3<T> (&x)[3], const Vec3<T> (&v)[3],
                                  const Mat22<T>& pose, const T& activation,
                                  const TriangleMaterial<T>& material) {
  using namespace math;
  const Vec3<T> x10 = x[1] - x[0], x20 = x[2] - x[0];
  const Vec3<T> v10 = v[1] - v[0], v20 = v[2] - v[0];
  const T inverse_area = determinant(pose) * T(2.0f);
  const T rest_area = T(1.0f) / inverse_area;
  const TriangleMaterial<T> scaled = {material.ke * rest_area, material.ka * rest_area,
                                      material.kd * rest_area, material.drag, material.lift};

  const auto& d = pose.m;
  const Vec3<T> f_1 = x10 * d[0][0] + x20 * d[1][0], f_2 = x10 * d[0][1] + x20 * d[1][1];
  const Vec3<T> g_1 = v10 * d[0][0] + v20 * d[1][0], g_2 = v10 * d[0][1] + v20 * d[1][1];
  const Vec3<T> p_1 = f_1 * scaled.ke + g_1 * scaled.kd;
  const Vec3<T> p_2 = f_2 * scaled.ke + g_2 * scaled.kd;
  const triangle_detail::Edges<T> membrane = {p_1 * d[0][0] + p_2 * d[0][1],
                                              p_1 * d[1][0] + p_2 * d[1][1]};

  const Vec3<T> doubled = cross(x10, x20);
  const T area = length(doubled) * T(0.5f);
  const Vec3<T> n = normalize(doubled);
  const auto [f1, f2] = triangle_detail::add_area_force(membrane, x10, x20, v, n, area,
                                                        inverse_area, activation, scaled);
  const Vec3<T> f0 = f1 + f2;

  const Vec3<T> vm = ((v[0] + v[1]) + v[2]) * T(0.3333f);
  const Vec3<T> direction = normalize(vm);
  const Vec3<T> drag = vm * ((material.drag * area) * abs(dot(n, vm)));
  const T angle = T(1.57079632679f) - acos(dot(n, direction));
  const Vec3<T> lift = (n * ((material.lift * area) * angle)) * dot(vm, vm);
  return {(f0 - drag) - lift, -((f1 + drag) + lift), -((f2 + drag) + lift)};
}

}  // namespace novaphy
