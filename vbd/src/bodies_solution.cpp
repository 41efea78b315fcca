// The solution of a step of bodies: more iterations, the residual, and what derivatives read.
#include <cmath>

#include "bodies.h"
#include "bodies_solution.h"

namespace novaphy::vbd {
namespace {

constexpr double kRounding = 6e-8;  // relative, of a float

double wide(float v) { return static_cast<double>(v); }
double size_of(const Vec3f& v) { return wide(math::length(v)); }

// Returns the norm of a force and a moment about the center (N): the square of the force, plus the
// mass times the square of the moment in the metric of the inverse inertia.
double norm_on(const VbdBody& body, const SpatialVectorf& f) {
  const float inertia[3][3] = {{body.xx, body.xy, body.xz},
                               {body.xy, body.yy, body.yz},
                               {body.xz, body.yz, body.zz}};
  const float moment[3] = {f.angular.x, f.angular.y, f.angular.z};
  float turn[3];
  math::solve(math::ldlt(inertia), moment, turn);
  const Vec3f by_inertia = {turn[0], turn[1], turn[2]};
  return std::sqrt(wide(math::dot(f.linear, f.linear)) +
                   wide(body.mass_by_h2) * wide(math::dot(f.angular, by_inertia)));
}

struct BodyResidual {
  SpatialVectorf force{};
  double scale = 0.0, floor = 0.0;  // N
};

// Adds the force of a joint to a body, and the force that the rounding of positions can cause.
void add_joint(BodyResidual& to, const VbdBody& body, const VbdBodyJoint& j, int side,
               const VbdBodyMotion& a, const VbdBodyMotion& b) {
  const JointForce f = joint_force(j, a, b);
  const SpatialVectorf wrench = wrench_on({f.force, f.moment}, f.arm[side], side);
  to.force = to.force + wrench;
  to.scale += norm_on(body, wrench);
  const double length = size_of(a.moved) + size_of(b.moved) +
                        size_of(rotate_change(a.turned, j.arm[0])) +
                        size_of(rotate_change(b.turned, j.arm[1])) + size_of(j.gap);
  for (int k = 0; k < f.count; ++k) {
    const JointRow& row = f.rows[k];
    const bool turns = math::dot(row.linear, row.linear) == 0.0f;
    const double error = kRounding * (turns ? 1.0 : length);
    to.floor += wide(row.k) * error * norm_on(body, {row.linear, row.angular[side]});
  }
}

// As add_joint, for a contact.
void add_contact(BodyResidual& to, const VbdBody& body, const VbdBodyContact& c, int side,
                 const VbdBodyMotion& a, const VbdBodyMotion& b, float slip_bound) {
  const ContactForce f = contact_force(c, a, b, slip_bound);
  if (f.normal == 0.0f) return;
  const Vec3f& arm = c.arm[side];
  const SpatialVectorf wrench = wrench_on({c.normal * f.normal + f.friction, {}}, arm, side);
  to.force = to.force + wrench;
  to.scale += norm_on(body, wrench);
  const double length = size_of(a.moved) + size_of(b.moved) +
                        size_of(math::cross(a.turn, c.arm[0])) +
                        size_of(math::cross(b.turn, c.arm[1])) + std::abs(wide(c.gap));
  for_contact_rows(c, f, [&](float k, const Vec3f& linear) {
    to.floor += wide(k) * kRounding * length * norm_on(body, {linear, math::cross(arm, linear)});
  });
}

// Returns the friction of a contact at the border of its cone. Inside of the cone: 0.
Vec3f sliding_friction(const VbdBodyContact& c) {
  const float cone = 0.9999f * c.mu * c.lam_n;
  return math::dot(c.lam_t, c.lam_t) > cone * cone ? c.lam_t : Vec3f{};
}

}  // namespace

VbdResidual Bodies::residual() const {
  VbdResidual worst;
  bool is_first = true;
  for (size_t tree = 0; tree + 1 < graph_.tree_first.size(); ++tree) {
    VbdResidual of;
    double floor = 0.0;
    for (int32_t node = graph_.tree_first[tree]; node < graph_.tree_first[tree + 1]; ++node) {
      const int32_t b = graph_.nodes[static_cast<size_t>(node)];
      const VbdBody& body = body_[static_cast<size_t>(b)];
      const VbdBodyMotion& motion = motion_[static_cast<size_t>(b)];
      BodyResidual sum;
      sum.force = inertia_force(body, motion);
      sum.scale = norm_on(body, sum.force);
      sum.floor = kRounding * wide(body.mass_by_h2) * size_of(motion.moved);
      for (const int32_t item : graph_.rows.of(b)) {
        const auto k = static_cast<size_t>(item >> 3);
        const auto at = [&](int32_t which) { return motion_of(motion_.data(), which); };
        if (((item >> 1) & 3) == kContactRow) {
          const VbdBodyContact& c = contact_[k];
          add_contact(sum, body, c, item & 1, at(c.body[0]), at(c.body[1]),
                      options_.friction_epsilon * dt_);
        } else {
          const VbdBodyJoint& j = joint_[k];
          add_joint(sum, body, j, item & 1, at(j.body[0]), at(j.body[1]));
        }
      }
      const double force = norm_on(body, sum.force);
      of.force += force * force;
      of.scale += sum.scale * sum.scale;
      floor += sum.floor * sum.floor;
    }
    of.force = std::sqrt(of.force);
    of.scale = std::sqrt(of.scale);
    if (of.force > 0.0) of.relative = of.force / of.scale;
    if (of.scale > 0.0) of.floor = std::sqrt(floor) / of.scale;
    const auto rank = [](const VbdResidual& r) {
      return std::pair(r.relative > 2.0 * r.floor, r.relative);
    };
    if (is_first || rank(of) > rank(worst)) worst = of;
    is_first = false;
  }
  return worst;
}

void Bodies::iterate_to_solution() {
  constexpr float kSofter = 0.25f;
  last_rows_.clear();
  last_friction_.clear();
  for (const VbdBodyJoint& j : joint_)
    for (const VbdAxisRow& row : j.rows) last_rows_.push_back(row.lam);
  for (const VbdBodyContact& c : contact_) last_friction_.push_back(sliding_friction(c));
  iterate();
  for (size_t k = 0; k < contact_.size(); ++k) {
    VbdBodyContact& c = contact_[k];
    const Vec3f before = last_friction_[k];
    const bool slid = math::dot(before, before) > 0.0f;
    if (slid && !(math::dot(before, sliding_friction(c)) > 0.0f)) c.rho_t *= kSofter;
  }
  auto last = last_rows_.begin();
  for (VbdBodyJoint& j : joint_)
    for (VbdAxisRow& row : j.rows) {
      const float lam = *last++;
      const bool was_at_bound = lam == row.lower || lam == row.upper;
      if (was_at_bound && row.lam != lam && std::isfinite(row.upper - row.lower))
        row.rho *= kSofter;
    }
}

void Bodies::soften_rows() {
  constexpr float kSofter = 0.5f;
  for (VbdBodyJoint& j : joint_) {
    for (auto* const rows : {&j.points, &j.turns})
      for (VbdJointRow& row : *rows) row.rho *= kSofter;
    for (VbdAxisRow& row : j.rows) row.rho *= kSofter;
  }
  for (VbdBodyContact& c : contact_) {
    c.rho *= kSofter;
    c.rho_t *= kSofter;
  }
}

VbdBodySolution Bodies::solution() const {
  return {.motion = motion_,
          .joint = joint_,
          .joints = joints_,
          .is_kinematic = is_kinematic_.to_host(),
          .contact = contact_,
          .contact_origin = contact_origin_};
}

}  // namespace novaphy::vbd
