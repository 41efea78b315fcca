#include "novaphy/dynamics/semi_implicit/contact_stability.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <iterator>
#include <limits>
#include <utility>
#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/core/sim/on_host.h"
#include "novaphy/core/storage.h"
#include "novaphy/core/warning.h"
#include "novaphy/dynamics/semi_implicit/rigid_contact_trace.h"
#include "novaphy/math/matrix.h"
#include "novaphy/math/spatial.h"
#include "touching_rows.h"

namespace novaphy {
namespace {

constexpr float kNone = std::numeric_limits<float>::infinity();

// Returns true for the steps 1, 2, 4, 8, ..., 1024, 2048, 3072, ...
bool is_rare(uint64_t step) {
  constexpr uint64_t kOften = 1024;
  return std::has_single_bit(step) || step % kOften == 0;
}

using Six = std::array<float, 6>;
struct Matrix {
  float m[6][6] = {};
  void add(float k, const Six& j) {
    for (size_t a = 0; a < 6; ++a)
      for (size_t b = 0; b < 6; ++b) m[a][b] += k * j[a] * j[b];
  }
  void add(const Matrix& other) {
    for (size_t a = 0; a < 6; ++a)
      for (size_t b = 0; b < 6; ++b) m[a][b] += other.m[a][b];
  }
  Six times(const Six& x) const {
    Six y{};
    for (size_t i = 0; i < 6; ++i)
      for (size_t j = 0; j < 6; ++j) y[i] += m[i][j] * x[j];
    return y;
  }
};
struct Terms {
  Matrix springs, dampers, friction;
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

// Returns the acceleration M^-1 y of a body with the orientation q, by a wrench y.
Six accelerate(const Six& y, float inv_mass, const Mat33f& inv_inertia, const Quatf& q) {
  const Vec3f t = math::rotate(
      q, math::multiply(inv_inertia, math::rotate_inverse(q, Vec3f{y[3], y[4], y[5]})));
  return {y[0] * inv_mass, y[1] * inv_mass, y[2] * inv_mass, t.x, t.y, t.z};
}

// Returns the largest eigenvalue of M^-1 A by power iteration. x: initial vector, then eigenvector.
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

constexpr Six kStart = {1.0f, 0.9f, -0.8f, 0.7f, 0.6f, -0.5f};

// Returns whether the largest eigenvalue of M^-1 (dt^2 springs + dt dampers) is above 4.
template <class Accelerate>
bool grows(const Matrix& springs, const Matrix& dampers, float dt, Accelerate accelerate) {
  Matrix sum;
  for (size_t i = 0; i < 6; ++i)
    for (size_t j = 0; j < 6; ++j) sum.m[i][j] = (dt * springs.m[i][j] + dampers.m[i][j]) * dt;
  float trace = 0.0f;  // an upper bound of the eigenvalues
  for (size_t i = 0; i < 6; ++i) {
    Six column;
    for (size_t j = 0; j < 6; ++j) column[j] = sum.m[j][i];
    trace += accelerate(column)[i];
  }
  Six x = kStart;
  return trace > 4.0f && largest(sum, accelerate, x) > 4.0f;
}

// Returns the dt that solves springs dt^2 + dampers dt = 4.
float longest_dt(float springs, float dampers) {
  return 8.0f / (dampers + std::sqrt(dampers * dampers + 16.0f * springs));
}

// Returns the dt at which the largest eigenvalue of M^-1 (dt^2 springs + dt dampers) is 4. The
// Rayleigh quotient of a vector gives an upper bound, that of the eigenvector the next iterate.
template <class Accelerate>
float longest_dt(const Terms& terms, Accelerate accelerate) {
  Six x = kStart, y = x;
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
    // x is M^-1 y for some y, so x^T M x is x^T y. For the eigenvalue w, w x^T M x = x^T A x.
    const float of_sum = dot(x, sum.times(x)) / w;
    dt = longest_dt(dot(x, terms.springs.times(x)) / of_sum,
                    dot(x, terms.dampers.times(x)) / of_sum);
    if (std::abs(dt - before) <= 1e-4f * dt) break;
  }
  return dt;
}

using detail::TouchingRows;

// Adds the stiffness and damping of one side of contact row k, for a body that moves.
void add_side(const TouchingRows& rows, size_t k, const TouchingRows::Row& r, size_t side,
              Stability stability, float stick_ke, Terms& m) {
  const bool enough = stability == Stability::Enough;
  const bool both = rows.moves(r.bodies[0]) && rows.moves(r.bodies[1]);
  const float f = both && enough ? 2.0f : 1.0f;
  const auto b = static_cast<size_t>(r.bodies[side]);
  const Vec3f arm = r.at[side] - math::transform_point(rows.q[b], rows.com[b]);
  const Six n = motion(rows.normal[k], arm);
  m.springs.add(f * rows.ke_of(k, r), n);
  m.dampers.add((enough ? 2.0f * f : 1.0f) * rows.kd_of(k, r), n);
  const float kf = enough || rows.slides(k, r) ? 2.0f * f * rows.mean(rows.kf, r) : 0.0f;
  const float stick = enough ? f * stick_ke : 0.0f;
  for (const Vec3f& u : {Vec3f{1, 0, 0}, Vec3f{0, 1, 0}, Vec3f{0, 0, 1}}) {
    m.springs.add(stick, motion(u, arm));
    m.friction.add(kf, motion(u, arm));
  }
  m.springs.add(-stick, n);
  m.friction.add(-kf, n);
}

}  // namespace

float stable_contact_dt(const char* function, const Model& model, const SimState& state,
                        const Contacts& contacts, float stick_ke) {
  require(state.model_id() == model.id() && contacts.model_id() == model.id(), ErrorKind::Value,
          function, ": expected a state and contacts of the solver's model, got others");
  const UntrackedScope untracked;
  require(!contacts.overflowed(), ErrorKind::Value, function,
          ": contacts: expected room for all rows, got fewer than there are; raise "
          "rigid_contact_max");
  model.update_derived();
  const TouchingRows rows(model, state, contacts, false, nullptr);
  std::vector<Terms> terms(rows.q.size());
  for (size_t k = 0; k < rows.count; ++k) {
    const TouchingRows::Row r = rows.row(k);
    if (!(r.depth > 0.0f)) continue;
    for (size_t side = 0; side < 2; ++side)
      if (rows.moves(r.bodies[side]))
        add_side(rows, k, r, side, Stability::Enough, stick_ke,
                 terms[static_cast<size_t>(r.bodies[side])]);
  }
  const OnHost<float> inv_mass(model.body_inv_mass);
  const OnHost<Mat33f> inv_inertia(model.body_inv_inertia);
  float least = kNone;
  for (size_t b = 0; b < terms.size(); ++b) {
    terms[b].dampers.add(terms[b].friction);
    least = std::min(least, longest_dt(terms[b], [&](const Six& y) {
                       return accelerate(y, inv_mass[b], inv_inertia[b], rows.q[b].q);
                     }));
  }
  return least;
}

bool ContactWatch::is_due(bool is_dear) {
  ++steps_;
  const bool all_warned = warned_ && warned_of_friction_ && warned_of_depth_ && warned_of_pose_;
  return !all_warned && (!is_dear || is_rare(steps_));
}

void ContactWatch::look(const Model& model, const SimState& state, const Contacts& contacts,
                        float dt, bool pushed, const std::vector<uint8_t>* bodies) {
  constexpr uint64_t kDepths = 32;
  const UntrackedScope untracked;
  if (is_rare(steps_)) check_poses(state);
  if (contacts.rigid_contact_max() == 0) return;
  const TouchingRows rows(model, state, contacts, pushed, bodies);
  if (!warned_ || !warned_of_friction_) find_changed(rows, model, dt);
  if (!warned_of_depth_ && (is_rare(steps_) || steps_ % kDepths == 0)) check_depths(rows, model);
}

void ContactWatch::find_changed(const TouchingRows& rows, const Model& model, float dt) {
  const Array* const read[] = {&model.shape_material_ke, &model.shape_material_kd,
                               &model.shape_material_kf, &model.body_inv_mass,
                               &model.body_inv_inertia};
  bool known = dt <= longest_dt_ && touched_.size() == rows.q.size();
  for (size_t i = 0; i < std::size(read); ++i) known = known && read_[i].matches(*read[i]);
  if (!known) {
    longest_dt_ = dt;
    for (size_t i = 0; i < std::size(read); ++i) read_[i].set(*read[i]);
    touched_.assign(rows.q.size(), {});
  }
  touching_.clear();
  changed_.clear();
  const auto of = [&](int32_t b) -> Touched& { return touched_[static_cast<size_t>(b)]; };
  for (size_t k = 0; k < rows.count; ++k) {
    if (!rows.touches(k)) continue;
    const auto a = static_cast<uint32_t>(rows.shape0[k]), b = static_cast<uint32_t>(rows.shape1[k]);
    const uint32_t pair = (a * 0x9E3779B9u) ^ (b * 0x85EBCA6Bu) ^ 0xC2B2AE35u;
    for (const uint32_t shape : {a, b}) {
      const int32_t body = rows.body[shape];
      if (!rows.counts(body)) continue;
      if (of(body).now == 0) touching_.push_back(body);
      of(body).now += pair | 1u;
    }
  }
  for (const int32_t b : touching_) {
    Touched& t = of(b);
    t.changed = -1;
    const uint32_t now = std::exchange(t.now, 0);
    if (now == 0 || std::find(std::begin(t.seen), std::end(t.seen), now) != std::end(t.seen))
      continue;
    t.seen[t.next] = now;
    t.next = (t.next + 1) % 4;
    t.changed = static_cast<int32_t>(changed_.size());
    changed_.push_back(b);
  }
  if (changed_.empty()) return;
  std::vector<Terms> terms(changed_.size());
  for (size_t k = 0; k < rows.count; ++k) {
    if (!rows.touches(k)) continue;
    const TouchingRows::Row r = rows.row(k);
    for (size_t side = 0; side < 2; ++side)
      if (rows.counts(r.bodies[side]) && of(r.bodies[side]).changed >= 0)
        add_side(rows, k, r, side, Stability::Needed, 0.0f,
                 terms[static_cast<size_t>(of(r.bodies[side]).changed)]);
  }
  const OnHost<float> inv_mass(model.body_inv_mass);
  const OnHost<Mat33f> inv_inertia(model.body_inv_inertia);
  ContactLimit least = {kNone}, least_of_friction = {kNone};
  for (size_t i = 0; i < changed_.size(); ++i) {
    const auto b = static_cast<size_t>(changed_[i]);
    of(changed_[i]).changed = -1;
    const auto by_mass = [&](const Six& y) {
      return accelerate(y, inv_mass[b], inv_inertia[b], rows.q[b].q);
    };
    if (!warned_ && grows(terms[i].springs, terms[i].dampers, dt, by_mass)) {
      const float limit = longest_dt(terms[i], by_mass);
      if (limit < least.dt) least = {limit, changed_[i]};
    }
    Six x = kStart;
    if (!warned_of_friction_ && grows({}, terms[i].friction, dt, by_mass)) {
      const float limit = 4.0f / largest(terms[i].friction, by_mass, x);
      if (limit < least_of_friction.dt) least_of_friction = {limit, changed_[i]};
    }
  }
  check(least, dt);
  check_friction(least_of_friction, dt);
}

void ContactWatch::check_depths(const TouchingRows& rows, const Model& model) {
  constexpr float kDeep = 0.25f;  // fraction of the radius of gyration
  std::vector<Load>& loads = loads_;
  loads.assign(rows.q.size(), {});
  const OnHost<Vec3f> gravity(model.gravity);
  const OnHost<int32_t> world(model.body_world);
  const auto gravity_of = [&](size_t b) {
    return gravity[world[b] < 0 ? gravity.size() - 1 : static_cast<size_t>(world[b])];
  };
  for (size_t k = 0; k < rows.count; ++k) {
    if (!rows.touches(k)) continue;
    const TouchingRows::Row r = rows.row(k);
    for (size_t side = 0; side < 2; ++side) {
      if (!rows.counts(r.bodies[side])) continue;
      const auto b = static_cast<size_t>(r.bodies[side]);
      const Vec3f g = gravity_of(b);
      const float size = math::length(g);
      if (!(size > 0.0f)) continue;
      const float up = math::dot(rows.normal[k], g) * (side == 0 ? 1.0f : -1.0f) / size;
      loads[b].lift += rows.ke_of(k, r) * r.depth * up;
      if (!(up > 0.5f)) continue;
      loads[b].depth = std::max(loads[b].depth, r.depth);
      loads[b].stiffest = std::max(loads[b].stiffest, rows.ke_of(k, r));
      ++loads[b].rows;
    }
  }
  const OnHost<float> mass(model.body_mass);
  const OnHost<Mat33f> inertia(model.body_inertia);
  for (size_t b = 0; b < loads.size(); ++b) {
    if (!(loads[b].depth > 0.0f)) continue;
    const Mat33f& i = inertia[b];
    const float radius = std::sqrt((i.m[0][0] + i.m[1][1] + i.m[2][2]) / (3.0f * mass[b]));
    const float weight = mass[b] * math::length(gravity_of(b));
    // The depth at rest on as many contacts, at least those of all corners of a box.
    const float rest =
        weight / (loads[b].stiffest * static_cast<float>(std::max(loads[b].rows, 8)));
    if (loads[b].stiffest > 0.0f && rest > radius) {
      warned_of_depth_ = true;
      return warn_of(function_, ": contacts: body ", b, " sinks: springs of ke ", loads[b].stiffest,
                     " N/m carry its weight of ", weight, " N only ", rest,
                     " m deep; raise ke of its shapes, or take SolverFeatherstone, which needs "
                     "none");
    }
    // If the springs carry about the weight of the body, the body rests on the contacts.
    if (!(loads[b].depth > kDeep * radius) || loads[b].lift < 0.5f * weight ||
        loads[b].lift > 1.05f * weight)
      continue;
    warned_of_depth_ = true;
    return warn_of(function_, ": contacts: body ", b, " rests ", loads[b].depth,
                   " m deep where springs of ke carry its weight of ", weight,
                   " N; raise ke of its shapes, or take SolverFeatherstone, which needs none");
  }
}

void ContactWatch::look_at_pairs(const Model& model, float dt) {
  if (warned_ && warned_of_friction_) return;
  const Array* const read[] = {&model.shape_material_ke, &model.shape_material_kd,
                               &model.shape_material_kf, &model.shape_material_mu,
                               &model.body_inv_mass};
  bool known = dt <= longest_dt_;
  for (size_t i = 0; i < std::size(read); ++i) known = known && read_[i].matches(*read[i]);
  if (known) return;
  longest_dt_ = dt;
  for (size_t i = 0; i < std::size(read); ++i) read_[i].set(*read[i]);
  const UntrackedScope untracked;
  const std::vector<float> ke = model.shape_material_ke.to_host(),
                           kd = model.shape_material_kd.to_host(),
                           kf = model.shape_material_kf.to_host(),
                           mu = model.shape_material_mu.to_host(),
                           inv_mass = model.body_inv_mass.to_host();
  const std::vector<int32_t> body = model.shape_body.to_host(), flags = model.body_flags.to_host();
  ContactLimit least = {kNone}, least_of_friction = {kNone};
  for (const Vec2i& pair : model.shape_contact_pairs().to_host()) {
    const auto a = static_cast<size_t>(pair.x), b = static_cast<size_t>(pair.y);
    for (const size_t shape : {a, b}) {
      const int32_t of = body[shape];
      if (of < 0 || has_flag(flags[static_cast<size_t>(of)], BodyFlags::KINEMATIC)) continue;
      const float w = 0.5f * inv_mass[static_cast<size_t>(of)];
      const float limit = longest_dt((ke[a] + ke[b]) * w, (kd[a] + kd[b]) * w);
      if (limit < least.dt) least = {limit, of};
      if (!(mu[a] + mu[b] > 0.0f)) continue;
      const float of_friction = longest_dt(0.0f, 2.0f * (kf[a] + kf[b]) * w);
      if (of_friction < least_of_friction.dt) least_of_friction = {of_friction, of};
    }
  }
  check(least, dt);
  check_friction(least_of_friction, dt);
}

void ContactWatch::check_poses(const SimState& state) {
  if (warned_of_pose_) return;
  const OnHost<Transformf> poses(state.body_q);
  const Transformf *const q = poses.data(), *const end = q + poses.size();
  const auto bad = std::find_if(q, end, [](const Transformf& x) {
    return !std::isfinite(((x.p.x + x.p.y) + x.p.z) + ((x.q.x + x.q.y) + (x.q.z + x.q.w)));
  });
  if (bad == end) return;
  warned_of_pose_ = true;
  warn_of(function_, ": body_q[", bad - q,
          "]: expected finite numbers; the body meets nothing as it is");
}

void ContactWatch::check_friction(const ContactLimit& limit, float dt) {
  if (warned_of_friction_ || dt <= limit.dt) return;
  warned_of_friction_ = true;
  warn_of(function_, ": dt: ", dt, " s is longer than the ", limit.dt,
          " s up to which friction of body ", limit.body,
          " is stable with its mass and inertia and kf, so it shakes at the cone; ", advice_);
}

void ContactWatch::check(const ContactLimit& limit, float dt) {
  if (warned_ || dt <= limit.dt) return;
  warned_ = true;
  warn_of(function_, ": dt: ", dt, " s is longer than the ", limit.dt,
          " s up to which the contacts of body ", limit.body,
          " are stable with its mass and inertia and their ke and kd; ", advice_);
}

}  // namespace novaphy
