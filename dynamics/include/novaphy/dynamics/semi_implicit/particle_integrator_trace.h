// Symplectic Euler for a particle: the new velocity from the force, the new position from the new
// velocity.
//
//   v1 = v0 + (f*w + g*s)*dt   with s = 1 if w > 0, else 0
//   v1 = v1*(v_max/|v1|)  if |v1| > v_max
//   x1 = x0 + v1*dt
//
//   w         1/mass (1/kg), 0 for a kinematic particle
//   x, v, f   position (m), velocity (m/s), force (N), world frame
//   g         gravity (m/s^2), world frame
//   v_max     speed limit (m/s)
//   dt        step (s)
//
// A particle that is not active keeps position and velocity.
//
// Source: Newton 1.8.0, SolverSemiImplicit. The bits are those of Newton on the CPU, except that
// Newton does not write the velocity of an inactive particle.
//
// Gradient: exact for x0, v0, f, w, g, dt. Kink at |v1| = v_max, where the gradient is that of the
// branch without the limit. s has no gradient.
//
// Freestanding: T = float runs in the forward solver, T = nova::Real is traced.
#pragma once

#include "novaphy/math/types.h"

namespace novaphy {

template <class T>
struct ParticleState {
  Vec3<T> q{}, qd{};
};

template <class T>
ParticleState<T> integrate_particle(const Vec3<T>& x0, const Vec3<T>& v0, const Vec3<T>& f,
                                    const T& w, const Vec3<T>& g, const T& v_max, const T& dt) {
  using namespace math;
  const T s = step(-w);
  const Vec3<T> free = v0 + ((f * w) + (g * s)) * dt;
  const T speed = length(free);
  const Vec3<T> v1 = select(speed > v_max, free * (v_max / speed), free);
  return {x0 + v1 * dt, v1};
}

// Returns the new state of a particle, or x0 and v0 if it is not active. B: bool, or nova::Bool in
// a trace.
template <class B, class T>
ParticleState<T> integrate_particle(const B& active, const Vec3<T>& x0, const Vec3<T>& v0,
                                    const Vec3<T>& f, const T& w, const Vec3<T>& g, const T& v_max,
                                    const T& dt) {
  using namespace math;
  const ParticleState<T> next = integrate_particle(x0, v0, f, w, g, v_max, dt);
  return {select(active, next.q, x0), select(active, next.qd, v0)};
}

}  // namespace novaphy
