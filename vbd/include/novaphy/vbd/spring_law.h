// A spring in VBD, seen from its end x with the other end at x1.
//
// Law, with d = x - x1, l = max(|d|, 1e-8), u = d/l, the length ln at the start of the step h:
//   E = ke/2 (l - rest)^2 + kd/(2h) (l - ln)^2
//   f = -u (ke (l - rest) + kd/h (l - ln))
//   H = (ke + kd/h) u u^T + ke max(0, 1 - rest/l) (I - u u^T)
// H is the second derivative of E where l >= rest. Where the spring is pressed together that has
// a negative part, ke (1 - rest/l) across the spring, which H leaves out; Project = false keeps it.
// Symbols: x (m), ke (N/m), kd_by_h = kd/h (N/m), rest and ln (m).
//
// Source: Chen et al. (2024); Newton 1.8.0's SolverVBD has the same forces, and H without the max.
// Not smooth: l = rest in H; |d| < 1e-8, where u is d/1e-8.
// Gradient: exact in x, ke, kd, rest, ln away from these.
#pragma once

#include "novaphy/vbd/block_law.h"

namespace novaphy::vbd {

template <class T>
struct SpringLaw {
  T ke{}, kd_by_h{}, rest{};
};

template <class T>
T spring_length(const Vec3<T>& x, const Vec3<T>& x1) {
  using math::max;
  return max(math::length(x - x1), T(1e-8f));
}

template <bool Project = true, class T>
Block<T> spring_block(const Vec3<T>& x, const Vec3<T>& x1, const SpringLaw<T>& law,
                      const T& start_length) {
  using math::max;
  const T l = spring_length(x, x1), one = T(1.0f);
  const Vec3<T> u = (x - x1) / l;
  const T tension = law.ke * (l - law.rest) + law.kd_by_h * (l - start_length);
  const T slack = one - law.rest / l;
  const T across = law.ke * (Project ? max(T(0.0f), slack) : slack);
  Block<T> block;
  block.f = u * (-tension);
  add_identity(block, across);
  add_outer(block, (law.ke + law.kd_by_h) - across, u);
  return block;
}

template <class T>
T spring_energy(const Vec3<T>& x, const Vec3<T>& x1, const SpringLaw<T>& law,
                const T& start_length) {
  const T l = spring_length(x, x1);
  const T stretch = l - law.rest, moved = l - start_length;
  return T(0.5f) * ((law.ke * stretch) * stretch + (law.kd_by_h * moved) * moved);
}

}  // namespace novaphy::vbd
