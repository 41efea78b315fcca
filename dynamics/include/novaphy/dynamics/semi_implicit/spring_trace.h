// The force of a spring with a damper along it.
//
// Law, for the ends i and j:
//   u = unit(x_i - x_j),  f = u (ke (|x_i - x_j| - rest) + kd u.(v_i - v_j))
//   i gets -f, j gets f
// Symbols:
//   x, v       position (m) and velocity (m/s) of the ends, world frame
//   ke, kd     stiffness (N/m) and damping (N*s/m)
//   rest       length without a force (m)
//   f          N, world frame
// Source: Newton 1.8.0, SolverSemiImplicit. The bits are those of Newton on the CPU.
//
// For kd = 0 velocities are not read.
//
// If both ends coincide, u = 0, so the force and the gradient are 0 (Newton gives NaN). The force
// jumps there. Gradient: exact in x, v, ke, kd, rest elsewhere.
//
// Freestanding: T = float runs in the forward solver, T = nova::Real is traced.
#pragma once

#include "novaphy/math/types.h"

namespace novaphy {

// The forces of a spring on its ends.
template <class T>
struct SpringForces {
  Vec3<T> f0{}, f1{};
};

template <class T>
SpringForces<T> spring_forces(const Vec3<T>& x_i, const Vec3<T>& x_j, const Vec3<T>& v_i,
                              const Vec3<T>& v_j, const T& stiffness, const T& damping,
                              const T& rest_length) {
  using namespace math;
  const Vec3<T> x = x_i - x_j, v = v_i - v_j;
  const T l = length(x);
  const T zero = T(0.0f);
  // The test is l == 0, so that a NaN gives a NaN force.
  const Vec3<T> u = x * select(l == zero, zero, T(1.0f) / l);
  const Vec3<T> f = u * (stiffness * (l - rest_length) + optional_product(damping, dot(u, v)));
  return {-f, f};
}

}  // namespace novaphy
