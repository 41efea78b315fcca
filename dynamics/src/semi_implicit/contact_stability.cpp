#include "novaphy/dynamics/semi_implicit/contact_stability.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/core/storage.h"
#include "novaphy/core/warning.h"
#include "novaphy/dynamics/semi_implicit/rigid_contact_trace.h"
#include "novaphy/math/matrix.h"
#include "novaphy/math/spatial.h"

namespace novaphy {
namespace {

constexpr float kNone = std::numeric_limits<float>::infinity();

using Six = std::array<float, 6>;
struct Matrix {
  float m[6][6] = {};
  void add(float k, const Six& j) {
    for (size_t a = 0; a < 6; ++a)
      for (size_t b = 0; b < 6; ++b) m[a][b] += k * j[a] * j[b];
  }
  Six times(const Six& x) const {
    Six y{};
    for (size_t i = 0; i < 6; ++i)
      for (size_t j = 0; j < 6; ++j) y[i] += m[i][j] * x[j];
    return y;
  }
};
struct Terms {
  Matrix springs, dampers;
};

float dot(const Six& a, const Six& b) {
  float sum = 0.0f;
  for (size_t i = 0; i < 6; ++i) sum += a[i] * b[i];
  return sum;
}

Six motion(const Vec3f& u, const Vec3f& arm) {
  const Vec3f turn = math::cross(arm, u);
  return {u.x, u.y, u.z, turn.x, turn.y, turn.z};
}

// M^-1 y of a body that is turned by q.
Six accelerate(const Six& y, float inv_mass, const Mat33f& inv_inertia, const Quatf& q) {
  const Vec3f t = math::rotate(
      q, math::multiply(inv_inertia, math::rotate_inverse(q, Vec3f{y[3], y[4], y[5]})));
  return {y[0] * inv_mass, y[1] * inv_mass, y[2] * inv_mass, t.x, t.y, t.z};
}

// The largest eigenvalue of M^-1 A, by power iteration from x, which becomes its vector.
template <class Accelerate>
float largest(const Matrix& a, Accelerate accelerate, Six& x) {
  float w = 0.0f;
  for (int k = 0; k < 48; ++k) {
    const Six y = a.times(x), z = accelerate(y);
    const float xy = dot(x, y), zz = dot(z, z);
    if (!(xy > 0.0f) || !(zz > 0.0f)) return w;
    const float before = w;
    w = dot(y, z) / xy;
    for (size_t i = 0; i < 6; ++i) x[i] = z[i] / std::sqrt(zz);
    if (std::abs(w - before) <= 1e-4f * w) return w;
  }
  return w;
}

// The dt with springs dt^2 + dampers dt = 4.
float longest_dt(float springs, float dampers) {
  return 8.0f / (dampers + std::sqrt(dampers * dampers + 16.0f * springs));
}

// The dt at which the largest eigenvalue of M^-1 (dt^2 springs + dt dampers) is 4. The quotients of
// any vector give a longer one, those of the vector that belongs to it give the next.
template <class Accelerate>
float longest_dt(const Terms& terms, Accelerate accelerate) {
  Six x = {1.0f, 0.9f, -0.8f, 0.7f, 0.6f, -0.5f}, y = x;
  const float springs = largest(terms.springs, accelerate, x),
              dampers = largest(terms.dampers, accelerate, y);
  if (!(springs + dampers > 0.0f)) return kNone;
  if (springs == 0.0f || dampers == 0.0f) return longest_dt(springs, dampers);
  float dt = longest_dt(springs, dampers);
  for (size_t i = 0; i < 6; ++i) x[i] += y[i];
  for (int k = 0; k < 16; ++k) {
    Matrix sum;
    for (size_t i = 0; i < 6; ++i)
      for (size_t j = 0; j < 6; ++j)
        sum.m[i][j] = (dt * terms.springs.m[i][j] + terms.dampers.m[i][j]) * dt;
    const float w = largest(sum, accelerate, x), before = dt;
    // x is M^-1 y for some y, so x^T M x is x^T y; w x^T M x = x^T A x.
    const float of_sum = dot(x, sum.times(x)) / w;
    dt = longest_dt(dot(x, terms.springs.times(x)) / of_sum,
                    dot(x, terms.dampers.times(x)) / of_sum);
    if (std::abs(dt - before) <= 1e-4f * dt) break;
  }
  return dt;
}

// What the model and the contacts hold, on the host.
struct Rows {
  Rows(const Model& m, const SimState& state, const Contacts& c)
      : q(state.body_q.to_host()),
        com(m.body_com.to_host()),
        flags(m.body_flags.to_host()),
        body(m.shape_body.to_host()),
        ke(m.shape_material_ke.to_host()),
        kd(m.shape_material_kd.to_host()),
        kf(m.shape_material_kf.to_host()),
        row_ke(c.rigid_contact_stiffness.to_host()),
        row_kd(c.rigid_contact_damping.to_host()),
        contacts(c.rigid_contacts()) {
    const auto count = static_cast<int32_t>(body.size());
    for (const RigidContact& row : contacts)
      require(row.shape0 >= 0 && row.shape0 < count && row.shape1 >= 0 && row.shape1 < count,
              ErrorKind::Index, "contacts: rigid_contact_shape0, _shape1: expected 0 to ",
              count - 1, ", got ", row.shape0, " and ", row.shape1);
  }

  bool moves(int32_t b) const {
    return b >= 0 && !has_flag(flags[static_cast<size_t>(b)], BodyFlags::KINEMATIC);
  }
  Transformf pose(int32_t b) const {
    return b < 0 ? Transformf::identity() : q[static_cast<size_t>(b)];
  }

  std::vector<Transformf> q;
  std::vector<Vec3f> com;
  std::vector<int32_t> flags, body;
  std::vector<float> ke, kd, kf, row_ke, row_kd;
  std::vector<RigidContact> contacts;
};

void add_row(const Rows& rows, size_t k, Stability stability, float stick_ke,
             std::vector<Terms>& terms) {
  const RigidContact& c = rows.contacts[k];
  const size_t shapes[2] = {static_cast<size_t>(c.shape0), static_cast<size_t>(c.shape1)};
  const int32_t bodies[2] = {rows.body[shapes[0]], rows.body[shapes[1]]};
  const Vec3f at[2] = {
      math::transform_point(rows.pose(bodies[0]), c.point0) + c.normal * c.margin0,
      math::transform_point(rows.pose(bodies[1]), c.point1) - c.normal * c.margin1};
  if (!(math::dot(c.normal, at[1] - at[0]) < 0.0f)) return;
  const auto mean = [&](const std::vector<float>& of) {
    return (of[shapes[0]] + of[shapes[1]]) * 0.5f;
  };
  const auto own = [&](const std::vector<float>& of_rows, float of_shapes) {
    return of_rows.empty() || !(of_rows[k] > 0.0f) ? of_shapes : of_rows[k];
  };
  const float ke = own(rows.row_ke, mean(rows.ke)), kd = own(rows.row_kd, mean(rows.kd));
  const bool enough = stability == Stability::Enough;
  const bool both = rows.moves(bodies[0]) && rows.moves(bodies[1]);
  const float f = both && enough ? 2.0f : 1.0f;
  for (size_t side = 0; side < 2; ++side) {
    if (!rows.moves(bodies[side])) continue;
    const auto b = static_cast<size_t>(bodies[side]);
    const Vec3f arm = at[side] - math::transform_point(rows.q[b], rows.com[b]);
    const Six n = motion(c.normal, arm);
    Terms& m = terms[b];
    m.springs.add(f * ke, n);
    m.dampers.add(enough ? 2.0f * f * kd : kd, n);
    if (!enough) continue;
    const float kf = 2.0f * f * mean(rows.kf), stick = f * stick_ke;
    for (const Vec3f& u : {Vec3f{1, 0, 0}, Vec3f{0, 1, 0}, Vec3f{0, 0, 1}}) {
      m.springs.add(stick, motion(u, arm));
      m.dampers.add(kf, motion(u, arm));
    }
    m.springs.add(-stick, n);
    m.dampers.add(-kf, n);
  }
}

}  // namespace

ContactLimit contact_limit(const Model& model, const SimState& state, const Contacts& contacts,
                           Stability stability, float stick_ke,
                           const std::vector<uint8_t>* bodies) {
  const Rows rows(model, state, contacts);
  std::vector<Terms> terms(rows.q.size());
  for (size_t k = 0; k < rows.contacts.size(); ++k) add_row(rows, k, stability, stick_ke, terms);
  const std::vector<float> inv_mass = model.body_inv_mass.to_host();
  const std::vector<Mat33f> inv_inertia = model.body_inv_inertia.to_host();
  ContactLimit least = {kNone};
  for (size_t b = 0; b < terms.size(); ++b) {
    if (bodies != nullptr && (*bodies)[b] == 0) continue;
    const float dt = longest_dt(terms[b], [&](const Six& y) {
      return accelerate(y, inv_mass[b], inv_inertia[b], rows.q[b].q);
    });
    if (dt < least.dt) least = {dt, static_cast<int32_t>(b)};
  }
  return least;
}

float stable_contact_dt(const char* function, const Model& model, const SimState& state,
                        const Contacts& contacts, float stick_ke) {
  require(state.model_id() == model.id() && contacts.model_id() == model.id(), ErrorKind::Value,
          function, ": expected a state and contacts of the solver's model, got others");
  const Unobserved unobserved;
  require(!contacts.overflowed(), ErrorKind::Value, function,
          ": contacts: expected room for all rows, got fewer than there are; raise "
          "rigid_contact_max");
  model.update_derived();
  return contact_limit(model, state, contacts, Stability::Enough, stick_ke).dt;
}

bool ContactWatch::is_due() {
  constexpr uint64_t kOften = 1024;
  ++steps_;
  return !(warned_ && warned_of_pose_) && (std::has_single_bit(steps_) || steps_ % kOften == 0);
}

void ContactWatch::look(const Model& model, const SimState& state, const Contacts& contacts,
                        float dt, const std::vector<uint8_t>* bodies) {
  const Unobserved unobserved;
  check_poses(state);
  if (!warned_) check(contact_limit(model, state, contacts, Stability::Needed, 0.0f, bodies), dt);
}

void ContactWatch::look_at_pairs(const Model& model, float dt) {
  if (warned_) return;
  const Array* const read[] = {&model.shape_material_ke, &model.shape_material_kd,
                               &model.body_inv_mass};
  bool known = dt <= longest_dt_;
  for (size_t i = 0; i < std::size(read); ++i) known = known && read_[i].matches(*read[i]);
  if (known) return;
  longest_dt_ = dt;
  for (size_t i = 0; i < std::size(read); ++i) read_[i].set(*read[i]);
  const Unobserved unobserved;
  const std::vector<float> ke = model.shape_material_ke.to_host(),
                           kd = model.shape_material_kd.to_host(),
                           inv_mass = model.body_inv_mass.to_host();
  const std::vector<int32_t> body = model.shape_body.to_host(), flags = model.body_flags.to_host();
  ContactLimit least = {kNone};
  for (const Vec2i& pair : model.shape_contact_pairs.to_host()) {
    const auto a = static_cast<size_t>(pair.x), b = static_cast<size_t>(pair.y);
    for (const size_t shape : {a, b}) {
      const int32_t of = body[shape];
      if (of < 0 || has_flag(flags[static_cast<size_t>(of)], BodyFlags::KINEMATIC)) continue;
      const float w = 0.5f * inv_mass[static_cast<size_t>(of)];
      const float limit = longest_dt((ke[a] + ke[b]) * w, (kd[a] + kd[b]) * w);
      if (limit < least.dt) least = {limit, of};
    }
  }
  check(least, dt);
}

void ContactWatch::check_poses(const SimState& state) {
  if (warned_of_pose_) return;
  const std::vector<Transformf> q = state.body_q.to_host();
  const auto bad = std::find_if(q.begin(), q.end(), [](const Transformf& x) {
    return !std::isfinite(((x.p.x + x.p.y) + x.p.z) + ((x.q.x + x.q.y) + (x.q.z + x.q.w)));
  });
  if (bad == q.end()) return;
  warned_of_pose_ = true;
  warn_of(function_, ": body_q[", bad - q.begin(),
          "]: expected finite numbers; the body meets nothing as it is");
}

void ContactWatch::check(const ContactLimit& limit, float dt) {
  if (dt <= limit.dt) return;
  warned_ = true;
  warn_of(function_, ": dt: ", dt, " s is longer than the ", limit.dt,
          " s up to which the contacts of body ", limit.body,
          " are stable with its mass and inertia and their ke and kd; ", advice_);
}

}  // namespace novaphy
