// A contact of a particle with a shape in VBD: a penalty, its damping, and friction.
//
// Law, for a particle at x, with xn at the start of the step and the step size h. The point p of
// the surface moves with the velocity v_s. The unit normal n points out of the shape. R is the
// particle's radius plus the shape's margin. The contact acts while the overlap
// pen = R - n.(x - p) is > 0. With the relative displacement u = (x - xn) - h v_s:
//   f = n (ke pen - kd/h min(n.u, 0)) - c u_t,  u_t = u - n (n.u)
//   H = (ke + [n.u < 0] kd/h) n n^T + c (I - n n^T)
//   c = mu ke pen / |u_t|                      for |u_t| > eps = friction_epsilon h
//   c = mu ke pen (2 - |u_t|/eps) / eps        for |u_t| <= eps
//
// If `inside` is 1, the damping force is kd/h min(-n.u, pen) where n.u < 0, which makes f
// continuous.
//
// The coefficients ke and kd are the arithmetic means of the model's and the shape's values. mu is
// the geometric mean. H has c in the direction of the slip, although the derivative of the force in
// that direction is about 0. With the smaller stiffness the iteration does not converge. p, n and
// v_s are constant in a step.
// Symbols: x (m), ke (N/m), kd (N*s/m), mu (1), eps (m).
//
// Beside a coarse correction H also has ke (1 - gap/b)^2 n n^T while the gap -pen is between 0 and
// b = 0.1 R. A step towards the surface then meets the stiffness that begins there. Without it the
// step ends deep in the contact, and the next coarse step throws the particles out again.
//
// The safeguard against too long steps uses the energy
//   ke/2 pen^2 + [n.u < 0] kd/(2h) (n.u)^2 + mu ke pen_0 S(|u_t|), with S' = c |u_t|/(mu ke pen)
// The friction force has no potential. The energy therefore has pen_0, the overlap before the
// particle's step, as a constant.
//
// Source: Newton 1.8.0's SolverVBD, and the friction of Li et al., "Incremental Potential Contact"
// (2020). Newton drops c from f and H where u_t is 0, so a resting particle and a creeping particle
// have different laws. Here c keeps its limit 2 mu ke pen/eps.
//
// Not smooth: pen = 0, where f jumps by the damping unless `inside` is 1; n.u = 0 in H.
// Gradient: exact in x, xn, R, ke, kd and mu, except where the law is not smooth. p, n and v_s are
// frozen. eps has no gradient.
#pragma once

#include "novaphy/vbd/block_law.h"

namespace novaphy::vbd {

// `radius` is R (m), `slip` is eps (m), `travel` is h v_s (m), `inside` is 0 or 1, and `reach` is
// b/R, or 0 without this part of H.
template <class T>
struct ParticleContact {
  Vec3<T> point{}, normal{}, travel{};
  T radius{}, ke{}, kd_by_h{}, mu{}, slip{}, inside{}, reach{};
};

template <template <class> class B = Block, class T>
B<T> particle_contact_block(const Vec3<T>& x, const Vec3<T>& start, const ParticleContact<T>& c) {
  using namespace math;
  const T zero = T(0.0f), one = T(1.0f);
  const Vec3<T>& n = c.normal;
  const T depth = c.radius - dot(n, x - c.point);
  const Vec3<T> u = (x - start) - c.travel;
  const T un = dot(n, u);
  const Vec3<T> ut = u - n * un;
  const T squared = dot(ut, ut);
  const auto slides = squared > zero;
  const T root = sqrt(select(slides, squared, one));
  const T slip = select(slides, root, zero);
  const T shape = select(slip > c.slip, one / root, (T(2.0f) - slip / c.slip) / c.slip);
  const T friction = ((c.mu * c.ke) * depth) * shape;
  const T damping = select(un < zero, c.kd_by_h, zero);
  const T approach = -select(c.inside > zero, max(un, -depth), un);
  B<T> block;
  block.f = n * (c.ke * depth + damping * approach) - ut * friction;
  add_identity(block, friction);
  add_outer(block, (c.ke + damping) - friction, n);
  B<T> all = where(depth > zero, block);
  const T reach = max(c.reach * c.radius, T(1e-12f)), near = max(zero, one + depth / reach);
  const T ahead = select(c.reach > zero, (c.ke * near) * near, zero);
  add_outer(all, select(depth > zero, zero, ahead), n);
  return all;
}

// Returns the load ke pen (N) of the contact at x. The argument `load` of particle_contact_energy
// is this load at the position before the particle's step.
template <class T>
T particle_contact_load(const Vec3<T>& x, const ParticleContact<T>& c) {
  using namespace math;
  return c.ke * max(T(0.0f), c.radius - dot(c.normal, x - c.point));
}
template <class T>
T particle_contact_energy(const Vec3<T>& x, const Vec3<T>& start, const ParticleContact<T>& c,
                          const T& load) {
  using namespace math;
  const T zero = T(0.0f), half = T(0.5f), third = T(0x1.555556p-2f);
  const T depth = max(zero, c.radius - dot(c.normal, x - c.point));
  const Vec3<T> u = (x - start) - c.travel;
  const T un = dot(c.normal, u);
  const T slip = length(u - c.normal * un);
  const T part = slip / c.slip;
  const T below = (part * slip) * (T(1.0f) - part * third);
  const T distance = select(slip > c.slip, slip - c.slip * third, below);
  const T approach = select(depth > zero, min(un, zero), zero);
  return half * ((c.ke * depth) * depth + (c.kd_by_h * approach) * approach) +
         (c.mu * load) * distance;
}

// Returns the friction coefficient that gives, at the position x, the friction limit of the
// position `from`. The energy uses the same limit. If the contact has no overlap at x, the result
// is 0.
template <class T>
T friction_of_load(const Vec3<T>& x, const Vec3<T>& from, const ParticleContact<T>& c) {
  using namespace math;
  const T zero = T(0.0f), depth = c.radius - dot(c.normal, x - c.point);
  const auto acts = depth > zero;
  const T before = max(zero, c.radius - dot(c.normal, from - c.point));
  return select(acts, c.mu * (before / select(acts, depth, T(1.0f))), zero);
}

}  // namespace novaphy::vbd
