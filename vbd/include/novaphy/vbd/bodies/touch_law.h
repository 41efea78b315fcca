// A contact of a particle with a shape of a rigid body in VBD, as the body sees it. The force on
// the particle is that of particle_contact_law.h. The body gets the opposite force.
//
//   p = p_0 + u + rotate(q, r) - r,  travel = drift + u + turn x arm
// Symbols:
//   p        the point of the surface; p_0 at the start of the step (m)
//   u, q     displacement (m) and rotation of the body since the start; turn: rotation vector of q
//   r        lever of p_0 from the center of mass
//   arm      lever of the particle's center at the start. Both forces act there, so that momentum
//            and angular momentum are conserved.
//   travel   displacement of the surface since the start (m); drift: the part of a surface that
//            moves relative to its body
//
// In an iteration of the bodies the particle moves to its own equilibrium, linearized at its
// position x_0. With the total force f and stiffness H of the particle, and the stiffness K of the
// contact:
//   x = x_0 + H^-1 f + F (travel - travel_0),  F = H^-1 K
// The body therefore has the stiffness K - K F, of K and the rest of H in series. The solution does
// not depend on F.
#pragma once

#include "novaphy/vbd/bodies/body_law.h"
#include "novaphy/vbd/particle_contact_law.h"

namespace novaphy {

struct alignas(16) VbdTouch {
  using Element = Vec4f;
  int32_t body = -1, particle = -1;
  int32_t contact = -1;    // index in the list of all contacts of particles with shapes
  float has_acted = 0.0f;  // 1: the contact had a force in this step
  Vec3f point{}, core{}, arm{}, drift{}, travel{};
  Vec3f shift{}, follow[3] = {};          // H^-1 f, and the columns of F
  float is_fixed = 0.0f, unused[3] = {};  // 1: the particle is kinematic
};

namespace vbd {

inline Vec3f touch_point(const VbdTouch& t, const VbdBodyMotion& motion) {
  return (t.point + motion.moved) + rotate_change(motion.turned, t.core);
}
inline Vec3f touch_travel(const VbdTouch& t, const VbdBodyMotion& motion) {
  return (t.drift + motion.moved) + math::cross(motion.turn, t.arm);
}

// Returns the contact of a particle for a motion of the body. numbers: see put_contact_numbers.
// slip (m), inside: see ParticleContact.
inline ParticleContact<float> touch_contact(const VbdTouch& t, const VbdBodyMotion& motion,
                                            const float* numbers, float slip, float inside) {
  return {touch_point(t, motion),
          {numbers[3], numbers[4], numbers[5]},
          touch_travel(t, motion),
          numbers[9],
          numbers[10],
          numbers[11],
          numbers[12],
          slip,
          inside};
}

// Adds the stiffness k of a point at the lever `arm` to the block of a body.
inline void add_point_stiffness(BodyBlock& b, const Block<float>& k, const Vec3f& arm) {
  for (int c = 0; c < 6; ++c) {
    const Vec3f e = {c % 3 == 0 ? 1.0f : 0.0f, c % 3 == 1 ? 1.0f : 0.0f, c % 3 == 2 ? 1.0f : 0.0f};
    const Vec3f force = multiply_stiffness(k, c < 3 ? e : math::cross(e, arm));
    const Vec3f moment = math::cross(arm, force);
    const float column[6] = {force.x, force.y, force.z, moment.x, moment.y, moment.z};
    for (int r = c; r < 6; ++r) b.h[r][c] = b.h[r][c] + column[r];
  }
}

// Returns F v.
inline Vec3f followed(const VbdTouch& t, const Vec3f& v) {
  return (t.follow[0] * v.x + t.follow[1] * v.y) + t.follow[2] * v.z;
}

// Adds the force of a contact to the block of its body. x, start: the particle, now and at the
// start of the step (m).
template <bool with_stiffness>
void add_touch(BodyBlock& block, const VbdTouch& t, const Vec3f& x, const Vec3f& start,
               const ParticleContact<float>& c) {
  const Vec3f at = (x + t.shift) + followed(t, c.travel - t.travel);
  const Block<float> of_particle = particle_contact_block(at, start, c);
  add_force(block, -of_particle.f, math::cross(t.arm, -of_particle.f));
  if (!with_stiffness) return;
  Vec3f left[3];  // the columns of K - K F
  for (int k = 0; k < 3; ++k) {
    const Vec3f e = {k == 0 ? 1.0f : 0.0f, k == 1 ? 1.0f : 0.0f, k == 2 ? 1.0f : 0.0f};
    left[k] = multiply_stiffness(of_particle, e - t.follow[k]);
  }
  Block<float> series;
  series.h00 = left[0].x;
  series.h11 = left[1].y;
  series.h22 = left[2].z;
  series.h01 = 0.5f * (left[0].y + left[1].x);
  series.h02 = 0.5f * (left[0].z + left[2].x);
  series.h12 = 0.5f * (left[1].z + left[2].y);
  add_point_stiffness(block, series, t.arm);
}

// Notes whether a contact has a force for a particle at x.
inline void note_touch(VbdTouch& t, const ParticleContact<float>& c, const Vec3f& x) {
  if (c.radius - math::dot(c.normal, x - c.point) > 0.0f) t.has_acted = 1.0f;
}

// Stores the linearization of the particle's position. `of_particle`: see write_block.
inline void linearize_touch(VbdTouch& t, const Vec3f& x, const Vec3f& start,
                            const ParticleContact<float>& c, const float* of_particle) {
  t.travel = c.travel;
  const Block<float> k = particle_contact_block(x, start, c);
  if (t.is_fixed != 0.0f) return;
  const float* const h = of_particle + 3;
  const math::Ldlt<float, 3> factors =
      factorize(Block<float>{{}, h[0], h[1], h[2], h[3], h[4], h[5]}, 0.0f);
  t.shift = solve_block(factors, Vec3f{of_particle[0], of_particle[1], of_particle[2]});
  note_touch(t, c, x + t.shift);
  t.follow[0] = solve_block(factors, Vec3f{k.h00, k.h01, k.h02});
  t.follow[1] = solve_block(factors, Vec3f{k.h01, k.h11, k.h12});
  t.follow[2] = solve_block(factors, Vec3f{k.h02, k.h12, k.h22});
}

}  // namespace vbd
}  // namespace novaphy
