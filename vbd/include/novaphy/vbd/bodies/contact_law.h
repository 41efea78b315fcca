// The law of a rigid contact between the bodies A and B in VBD: a compliant one-sided normal force,
// and Coulomb friction. The law is an augmented Lagrangian.
//
//   C   = -(gap + n . (move_B - move_A)),  move = u + rotate(q, r) - r     depth (m)
//   F_n = max(0, k C + s lam_n + kd/h max(0, C - C_0)),  s = K/(K + rho), k = K rho/(K + rho)
//   F_t = the point of the disk of radius mu F_n nearest to lam_t - rho_t slip
//   slip = the tangential part of (u + turn x arm)_B - (u + turn x arm)_A    (m)
// Symbols:
//   n        unit normal from A to B at the start of the step; constant in the step
//   u, q     displacement (m) and rotation of a body since the start (body_law.h)
//   turn     rotation vector of q (rad)
//   r        lever of the nearest point of the shape's core, for example the center of a sphere
//   arm      lever of the point halfway between both surfaces. All forces act at this point, so
//            that momentum and angular momentum are conserved.
//   gap      distance of the surfaces at the start (m), less the margins, plus `ignored`;
//            C_0 = -gap
//   ignored  part of the depth (m) of two shapes that overlapped at their first step. This part
//            has no force, and shrinks from step to step.
//   K, kd    stiffness (N/m) and damping (N s/m) of the pair, mu its friction coefficient
//   rho      penalty stiffness of the iteration (N/m), which does not change the solution
//   lam      multipliers (N): lam_n <- max(0, s (lam_n + rho C)), then lam_t <- F_t
// At the solution lam_n = K C. A sticking contact does not slip, because friction has no
// compliance.
// Sources: Giles et al. 2025; the compliant form: Newton 1.8.0.
// Kinks: F_n = 0, the border of the friction cone, C = C_0.
#pragma once

#include "novaphy/vbd/bodies/body_law.h"

namespace novaphy {

template <class T>
struct alignas(16) VbdBodyContactOf {
  using Element = Vec4f;
  int32_t body[2] = {-1, -1};
  T gap{}, stiffness{};
  Vec3<T> normal{};
  T damping_by_h{};
  Vec3<T> core[2] = {}, arm[2] = {};
  T mu{};
  float rho = 0.0f, rho_t = 0.0f;
  T lam_n{};
  Vec3<T> lam_t{};
  float in_trees = 1.0f;  // scales the stiffness in the blocks of trees (bodies_kernels.h)
  float ignored = 0.0f;
};
using VbdBodyContact = VbdBodyContactOf<float>;

namespace vbd {

// A contact at the start of a step: the poses and centers of mass of its bodies, and the points of
// the cores in the axes of the bodies.
template <class T>
struct ContactStart {
  Transform<T> pose[2];
  Vec3<T> com[2], point[2], normal{};
  T margin[2] = {}, stiffness{}, damping{}, mu{};
};

// Sets the geometry of a contact, and its law. `points`: those of the cores, world frame.
template <class T>
void start_contact(const ContactStart<T>& start, const Vec3<T> (&points)[2], float h,
                   VbdBodyContactOf<T>& to) {
  to.stiffness = start.stiffness;
  to.damping_by_h = start.damping / T(h);
  to.mu = start.mu;
  to.normal = start.normal;
  const Vec3<T> n = to.normal;
  const Vec3<T> surfaces[2] = {points[0] + n * start.margin[0], points[1] + n * -start.margin[1]};
  to.gap = math::dot(n, surfaces[1] - surfaces[0]);
  const Vec3<T> middle = (surfaces[0] + surfaces[1]) * T(0.5f);
  for (int k = 0; k < 2; ++k) {
    const Vec3<T> center = math::transform_point(start.pose[k], start.com[k]);
    to.core[k] = points[k] - center;
    to.arm[k] = middle - center;
  }
}

// The force on B (N) and its stiffness (N/m): k_n n n^T + k_t (1 - n n^T - t t^T) + k_s t t^T, with
// the direction of the slip t.
struct ContactForce {
  float normal = 0.0f, k_n = 0.0f, k_t = 0.0f, k_s = 0.0f;
  Vec3f friction{}, slip_direction{};
};

template <class T>
T contact_depth(const VbdBodyContactOf<T>& c, const VbdBodyMotionOf<T>& a,
                const VbdBodyMotionOf<T>& b) {
  const Vec3<T> move = (b.moved + rotate_change(b.turned, c.core[1])) -
                       (a.moved + rotate_change(a.turned, c.core[0]));
  return -(c.gap + math::dot(c.normal, move));
}

template <class T>
Vec3<T> contact_slip(const VbdBodyContactOf<T>& c, const VbdBodyMotionOf<T>& a,
                     const VbdBodyMotionOf<T>& b) {
  const Vec3<T> move =
      (b.moved + math::cross(b.turn, c.arm[1])) - (a.moved + math::cross(a.turn, c.arm[0]));
  return move - c.normal * math::dot(c.normal, move);
}

// Returns the part k_d of the stiffness that damping adds: its force is k_d (C - C_0).
template <class T>
T contact_damping(const VbdBodyContactOf<T>& c, const T& depth) {
  return depth > T(0.0f) && depth + c.gap > T(0.0f) ? c.damping_by_h : T(0.0f);
}

// Returns v, shortened to the length `limit` if v is longer.
inline Vec3f within(const Vec3f& v, float limit) {
  const float l = math::length(v);
  return l > limit ? v * (limit / l) : v;
}

inline ContactForce contact_force(const VbdBodyContact& c, const VbdBodyMotion& a,
                                  const VbdBodyMotion& b, float slip_bound) {
  ContactForce f;
  const float depth = contact_depth(c, a, b), s = c.stiffness / (c.stiffness + c.rho);
  const float k = s * c.rho, damping = contact_damping(c, depth);
  f.normal = (k * depth + s * c.lam_n) + damping * (depth + c.gap);
  if (!(f.normal > 0.0f)) return {};
  f.k_n = k + damping;
  const float cone = c.mu * f.normal;
  if (!(cone > 0.0f)) return f;
  const Vec3f slip = contact_slip(c, a, b), wanted = c.lam_t - slip * c.rho_t;
  f.friction = within(wanted, cone);
  const float l = math::length(wanted);
  f.k_t = f.k_s = c.rho_t;
  if (!(l > cone)) return f;
  f.slip_direction = wanted * (1.0f / l);
  f.k_t = c.rho_t * (cone / l);
  f.k_s = math::min(f.k_t, cone / math::max(math::length(slip), slip_bound));
  return f;
}

// Updates the multipliers after an iteration. slip_bound (m): see contact_force.
inline void update_contact(VbdBodyContact& c, const VbdBodyMotion& a, const VbdBodyMotion& b,
                           float slip_bound) {
  const ContactForce f = contact_force(c, a, b, slip_bound);
  const float s = c.stiffness / (c.stiffness + c.rho);
  c.lam_n = math::max(0.0f, s * (c.lam_n + c.rho * contact_depth(c, a, b)));
  c.lam_t = f.friction;
}

// Calls row(k, linear) for each rank-1 term k j j^T of the stiffness of a contact. `linear` is the
// linear part of j. The angular part of j is cross(arm, linear).
template <class Row>
void for_contact_rows(const VbdBodyContact& c, const ContactForce& f, const Row& row) {
  using namespace math;
  row(f.k_n, c.normal);
  if (f.k_t == 0.0f) return;
  Vec3f t = f.slip_direction;
  if (dot(t, t) == 0.0f) t = perpendicular(c.normal).t[0];
  row(f.k_s, t);
  row(f.k_t, cross(c.normal, t));
}

// Adds the force of a contact to the block of body A (side 0) or B (side 1). Calls row(k, linear,
// angular, angular of the other body) for each rank-1 term of the stiffness.
template <bool with_stiffness, class Row>
void add_contact(BodyBlock& block, const VbdBodyContact& c, int side, const VbdBodyMotion& a,
                 const VbdBodyMotion& b, float slip_bound, const Row& row) {
  const ContactForce f = contact_force(c, a, b, slip_bound);
  if (f.normal == 0.0f) return;
  const Vec3f force = (c.normal * f.normal + f.friction) * (side == 0 ? -1.0f : 1.0f);
  const Vec3f arm = c.arm[side], other = c.arm[1 - side];
  add_force(block, force, math::cross(arm, force));
  if (!with_stiffness) return;
  for_contact_rows(c, f, [&](float k, const Vec3f& linear) {
    row(k, linear, math::cross(arm, linear), math::cross(other, linear));
  });
}

}  // namespace vbd
}  // namespace novaphy
