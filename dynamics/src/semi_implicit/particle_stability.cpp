#include "novaphy/dynamics/semi_implicit/particle_stability.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/core/storage.h"
#include "novaphy/core/warning.h"
#include "novaphy/dynamics/semi_implicit/tetrahedron_trace.h"
#include "novaphy/math/hinge.h"
#include "novaphy/math/spatial.h"

namespace novaphy {
namespace {

constexpr float kNone = std::numeric_limits<float>::infinity();

// A symmetric 3x3 matrix.
struct Block {
  float xx = 0, yy = 0, zz = 0, xy = 0, xz = 0, yz = 0;
  void add(float k, const Vec3f& v) {
    xx += k * v.x * v.x;
    yy += k * v.y * v.y;
    zz += k * v.z * v.z;
    xy += k * v.x * v.y;
    xz += k * v.x * v.z;
    yz += k * v.y * v.z;
  }
  void add_identity(float k) { xx += k, yy += k, zz += k; }
  Vec3f times(const Vec3f& v) const {
    return {xx * v.x + xy * v.y + xz * v.z, xy * v.x + yy * v.y + yz * v.z,
            xz * v.x + yz * v.y + zz * v.z};
  }
  // Returns the largest eigenvalue of A by power iteration, and its unit eigenvector in v.
  float largest(Vec3f& v) const {
    v = {0.6f, 0.57f, -0.56f};
    float w = 0.0f;
    for (int k = 0; k < 24; ++k) {
      const Vec3f y = times(v);
      const float length = math::length(y), before = w;
      if (!(length > 0.0f)) return w;
      v = y / length;
      w = math::dot(v, times(v));
      if (std::abs(w - before) <= 1e-4f * w) break;
    }
    return w;
  }
};
struct Terms {
  Block springs, dampers;
};

// Returns the dt that solves springs dt^2 + 2 dampers dt = 4.
float longest_dt(float springs, float dampers) {
  const float d = 2.0f * dampers;
  return springs + d > 0.0f ? 8.0f / (d + std::sqrt(d * d + 16.0f * springs)) : kNone;
}

float enough_dt(const Terms& terms, float inv_mass) {
  Vec3f v;
  return longest_dt(terms.springs.largest(v) * inv_mass, terms.dampers.largest(v) * inv_mass);
}
// Returns the stable dt along one direction: the smaller of the limits along the stiffest direction
// and the direction with the most damping.
float needed_dt(const Terms& terms, float inv_mass) {
  Vec3f stiff, damped;
  terms.springs.largest(stiff);
  terms.dampers.largest(damped);
  float least = kNone;
  for (const Vec3f& v : {stiff, damped})
    least = std::min(least, longest_dt(math::dot(v, terms.springs.times(v)) * inv_mass,
                                       math::dot(v, terms.dampers.times(v)) * inv_mass));
  return least;
}

class Elements {
 public:
  Elements(const Model& m, const std::vector<Vec3f>& q, const ParticleForces& forces,
           Stability stability)
      : q_(q), enough_(stability == Stability::Enough), terms_(q.size()) {
    if (forces.springs) add_springs(m);
    if (forces.triangles) add_triangles(m);
    if (forces.edges) add_edges(m);
    if (forces.tetrahedra) add_tetrahedra(m);
  }
  std::vector<Terms>& terms() { return terms_; }

 private:
  float share(int particles) const { return enough_ ? static_cast<float>(particles) : 1.0f; }
  bool known(int32_t p) const { return p >= 0 && static_cast<size_t>(p) < terms_.size(); }
  const Vec3f& at(int32_t p) const { return q_[static_cast<size_t>(p)]; }
  Terms& of(int32_t p) { return terms_[static_cast<size_t>(p)]; }

  void add_springs(const Model& m) {
    const auto ends = m.particle_spring_indices.to_host();
    const auto ke = m.particle_spring_stiffness.to_host(), kd = m.particle_spring_damping.to_host();
    for (size_t e = 0; e < ends.size(); ++e) {
      if (!known(ends[e].x) || !known(ends[e].y)) continue;
      const Vec3f u = math::normalize(at(ends[e].x) - at(ends[e].y));
      for (const int32_t p : {ends[e].x, ends[e].y}) {
        of(p).springs.add(share(2) * ke[e], u);
        of(p).dampers.add(share(2) * kd[e], u);
      }
    }
  }
  void add_triangles(const Model& m) {
    const auto corners = m.particle_tri_indices.to_host();
    const auto poses = m.particle_tri_pose.to_host();
    const auto materials = m.particle_tri_material.to_host();
    for (size_t e = 0; e < corners.size(); ++e) {
      const int32_t c[3] = {corners[e].x, corners[e].y, corners[e].z};
      if (!known(c[0]) || !known(c[1]) || !known(c[2])) continue;
      const auto& d = poses[e].m;
      const float area = 0.5f / (d[0][0] * d[1][1] - d[0][1] * d[1][0]);
      const float ke = materials[5 * e], ka = std::max(0.0f, materials[5 * e + 1]),
                  kd = materials[5 * e + 2], k = share(3) * area;
      const float w[3][2] = {
          {-(d[0][0] + d[1][0]), -(d[0][1] + d[1][1])}, {d[0][0], d[0][1]}, {d[1][0], d[1][1]}};
      // Derivative of the area by the position of corner a, divided by the rest area.
      const Vec3f n = math::normalize(math::cross(at(c[1]) - at(c[0]), at(c[2]) - at(c[0])));
      for (int a = 0; a < 3; ++a) {
        const Vec3f edge = at(c[(a + 2) % 3]) - at(c[(a + 1) % 3]);
        const Vec3f by_area = math::cross(n, edge) * (0.5f / area);
        const float square = w[a][0] * w[a][0] + w[a][1] * w[a][1];
        Terms& t = of(c[a]);
        t.springs.add_identity(k * ke * square);
        // the rest area gives no stiffness in this direction
        if (!enough_ && ka > 0.0f) t.springs.add(-k * ke * square, n);
        t.springs.add(k * ka, by_area);
        t.dampers.add_identity(k * kd * square);
        if (ka > 0.0f) t.dampers.add(k * kd, by_area);
      }
    }
  }
  void add_edges(const Model& m) {
    const auto corners = m.particle_edge_indices.to_host();
    const auto materials = m.particle_edge_material.to_host();
    for (size_t e = 0; e < corners.size(); ++e) {
      const int32_t c[4] = {corners[e].x, corners[e].y, corners[e].z, corners[e].w};
      if (!known(c[0]) || !known(c[1]) || !known(c[2]) || !known(c[3])) continue;
      const Vec3f x[4] = {at(c[0]), at(c[1]), at(c[2]), at(c[3])};
      const math::Hinge<float> h = math::make_hinge(x[0], x[1], x[2], x[3]);
      constexpr float kSmallest = 1e-6f;
      if (h.n1_length < kSmallest || h.n2_length < kSmallest || h.e_length < kSmallest) continue;
      // d_a is the direction of the force on corner a. The derivative of the angle has the same
      // direction, without the factors of the heights.
      const Vec3f of_1[4] = {-h.n1 * h.e_length,
                             {},
                             -h.n1 * math::dot(x[0] - x[3], h.e),
                             -h.n1 * math::dot(x[2] - x[0], h.e)};
      const Vec3f of_2[4] = {{},
                             -h.n2 * h.e_length,
                             -h.n2 * math::dot(x[1] - x[3], h.e),
                             -h.n2 * math::dot(x[2] - x[1], h.e)};
      const float ke = share(4) * h.e_length * materials[2 * e],
                  kd = share(4) * h.e_length * materials[2 * e + 1];
      for (int a = 0; a < 4; ++a) {
        const Vec3f d = of_1[a] + of_2[a];
        const float size = math::length(d),
                    by_angle = math::length(of_1[a] / h.n1_length + of_2[a] / h.n2_length);
        if (!(size > 0.0f)) continue;
        of(c[a]).springs.add(ke * by_angle / size, d);
        of(c[a]).dampers.add(kd, d);
      }
    }
  }
  void add_tetrahedra(const Model& m) {
    const auto corners = m.particle_tet_indices.to_host();
    const auto poses = m.particle_tet_pose.to_host();
    const auto materials = m.particle_tet_material.to_host();
    const auto is_lame = m.particle_tet_is_lame.to_host();
    for (size_t e = 0; e < corners.size(); ++e) {
      const int32_t c[4] = {corners[e].x, corners[e].y, corners[e].z, corners[e].w};
      if (!known(c[0]) || !known(c[1]) || !known(c[2]) || !known(c[3])) continue;
      const auto& d = poses[e].m;
      Vec3f w[4] = {{},
                    {d[0][0], d[0][1], d[0][2]},
                    {d[1][0], d[1][1], d[1][2]},
                    {d[2][0], d[2][1], d[2][2]}};
      w[0] = -(w[1] + w[2] + w[3]);
      const float volume = 1.0f / (6.0f * math::dot(w[1], math::cross(w[2], w[3])));
      const float k = share(4) * volume;
      const auto [mu, lambda, damp] = coefficients_of<bool, float>(
          is_lame[e] != 0, {materials[3 * e], materials[3 * e + 1], materials[3 * e + 2]});
      for (int a = 0; a < 4; ++a) {
        const float square = math::dot(w[a], w[a]);
        Terms& t = of(c[a]);
        t.springs.add_identity(k * 0.75f * mu * square);
        t.springs.add(k * (0.125f * mu + lambda), w[a]);
        t.dampers.add_identity(k * damp * square);
        t.dampers.add(k * damp, w[a]);
      }
    }
  }

  const std::vector<Vec3f>& q_;
  const bool enough_;
  std::vector<Terms> terms_;
};

// The contact materials between particles and each shape, and the worlds of the shapes.
struct Shapes {
  explicit Shapes(const Model& m)
      : ke(m.shape_material_ke.to_host()),
        kd(m.shape_material_kd.to_host()),
        kf(m.shape_material_kf.to_host()),
        world(m.shape_world.to_host()),
        of_world(static_cast<size_t>(m.world_count()) + 1) {
    const auto mean = [](std::vector<float>& values, float of_model) {
      for (float& v : values) v = 0.5f * (v + of_model);
    };
    mean(ke, m.soft_contact_ke);
    mean(kd, m.soft_contact_kd);
    mean(kf, m.soft_contact_kf);
    const std::vector<int32_t> flags = m.shape_flags.to_host();
    for (size_t s = 0; s < flags.size(); ++s)
      if (has_flag(flags[s], ShapeFlags::COLLIDE_PARTICLES) && world[s] < m.world_count())
        of_world[static_cast<size_t>(world[s] + 1)].push_back(s);
  }
  // Calls f for each shape that a particle of the world `particle_world` can touch.
  template <class F>
  void for_met(int32_t particle_world, F&& f) const {
    for (size_t w = 0; w < of_world.size(); ++w)
      if (w == 0 || particle_world < 0 || w == static_cast<size_t>(particle_world) + 1)
        for (const size_t s : of_world[w]) f(s);
  }
  std::vector<float> ke, kd, kf;
  std::vector<int32_t> world;
  std::vector<std::vector<size_t>> of_world;  // [0]: shapes of all worlds; then one list per world
};

// Returns the inverse masses, 0 for particles that do not move.
std::vector<float> inverse_masses(const Model& m) {
  std::vector<float> inv_mass = m.particle_inv_mass.to_host();
  const std::vector<int32_t> flags = m.particle_flags.to_host();
  for (size_t p = 0; p < inv_mass.size(); ++p)
    if (!has_flag(flags[p], ParticleFlags::ACTIVE)) inv_mass[p] = 0.0f;
  return inv_mass;
}

void take(ParticleLimit& least, float dt, size_t particle, const char* of) {
  if (dt < least.dt) least = {dt, static_cast<int32_t>(particle), of};
}

}  // namespace

ParticleLimit needed_particle_dt(const Model& model, const ParticleForces& forces) {
  const std::vector<float> inv_mass = inverse_masses(model);
  ParticleLimit least = {kNone};
  Elements elements(model, model.particle_q.to_host(), forces, Stability::Needed);
  for (size_t p = 0; p < inv_mass.size(); ++p)
    if (inv_mass[p] > 0.0f)
      take(least, needed_dt(elements.terms()[p], inv_mass[p]), p, "its elements");
  if (!forces.contacts) return least;
  const Shapes shapes(model);
  const std::vector<int32_t> world = model.particle_world.to_host();
  for (size_t p = 0; p < inv_mass.size(); ++p) {
    const float w = inv_mass[p];
    if (!(w > 0.0f)) continue;
    shapes.for_met(world[p], [&](size_t s) {
      take(least, longest_dt(shapes.ke[s] * w, 0.5f * shapes.kd[s] * w), p,
           "ke and kd of its contacts");
      if (forces.kf_bound > 2.0f)
        take(least, longest_dt(0.0f, shapes.kf[s] * w), p, "kf of its contacts");
    });
  }
  return least;
}

float enough_particle_dt(const char* function, const Model& model, const SimState& state,
                         const Contacts* contacts, const ParticleForces& forces) {
  require(state.model_id() == model.id(), ErrorKind::Value, function,
          ": expected a state and contacts of the solver's model, got others");
  const UntrackedScope untracked;
  model.update_derived();
  const std::vector<float> inv_mass = inverse_masses(model);
  const std::vector<Vec3f> q = state.particle_q.to_host();
  Elements elements(model, q, forces, Stability::Enough);
  std::vector<Terms>& terms = elements.terms();
  std::vector<uint8_t> slides(inv_mass.size(), 0);
  const Shapes shapes(model);
  const bool bounded = forces.kf_bound < 2.0f;
  const auto touch = [&](size_t p, size_t s, const Vec3f* normal) {
    Terms& t = terms[p];
    if (normal == nullptr) {
      t.springs.add_identity(shapes.ke[s]);
      t.dampers.add_identity(shapes.kd[s]);
    } else {
      t.springs.add(shapes.ke[s], *normal);
      t.dampers.add(shapes.kd[s], *normal);
    }
    if (bounded) {
      slides[p] = 1;
      return;
    }
    t.dampers.add_identity(shapes.kf[s]);
    if (normal != nullptr) t.dampers.add(-shapes.kf[s], *normal);
  };
  if (contacts != nullptr) {
    const std::vector<float> radius = model.particle_radius.to_host();
    const std::vector<int32_t> body = model.shape_body.to_host();
    const std::vector<Transformf> pose = state.body_q.to_host();
    for (const SoftContact& c : contacts->soft_contacts()) {
      const auto p = static_cast<size_t>(c.particle), s = static_cast<size_t>(c.shape);
      if (p >= q.size() || s >= body.size()) continue;
      const Vec3f at = body[s] < 0
                           ? c.body_pos
                           : math::transform_point(pose[static_cast<size_t>(body[s])], c.body_pos);
      if (math::dot(c.normal, q[p] - at) - radius[p] <= model.particle_adhesion)
        touch(p, s, &c.normal);
    }
  } else if (forces.contacts) {
    const std::vector<int32_t> world = model.particle_world.to_host();
    for (size_t p = 0; p < q.size(); ++p)
      shapes.for_met(world[p], [&](size_t s) { touch(p, s, nullptr); });
  }
  float least = kNone;
  for (size_t p = 0; p < inv_mass.size(); ++p) {
    if (!(inv_mass[p] > 0.0f)) continue;
    // With friction the condition is dt^2 K + 2 dt D + 2 b m <= 4 m, where b is kf_bound.
    const float left = slides[p] != 0 ? 4.0f / (4.0f - 2.0f * forces.kf_bound) : 1.0f;
    least = std::min(least, enough_dt(terms[p], left * inv_mass[p]));
  }
  return least;
}

void ParticleWatch::look(const Model& model, const ParticleForces& forces, float dt) {
  constexpr uint64_t kOften = 1024;
  ++calls_;
  if (warned_ || !(std::has_single_bit(calls_) || calls_ % kOften == 0)) return;
  const std::array<const Array*, kRead> read = {
      &model.particle_inv_mass,         &model.particle_flags,
      &model.particle_spring_stiffness, &model.particle_spring_damping,
      &model.particle_tri_material,     &model.particle_tri_pose,
      &model.particle_edge_material,    &model.particle_tet_material,
      &model.particle_tet_is_lame,      &model.particle_tet_pose,
      &model.shape_material_ke,         &model.shape_material_kd,
      &model.shape_material_kf};
  bool known = dt <= longest_dt_ && (had_contacts_ || !forces.contacts);
  for (size_t i = 0; i < kRead; ++i)
    known = known && (read[i]->rows() == 0 || read_[i].matches(*read[i]));
  if (known) return;
  longest_dt_ = dt;
  had_contacts_ = had_contacts_ || forces.contacts;
  for (size_t i = 0; i < kRead; ++i) read_[i].set(*read[i]);
  const UntrackedScope untracked;
  const ParticleLimit limit = needed_particle_dt(model, forces);
  if (dt <= limit.dt) return;
  warned_ = true;
  warn_of(function_, ": dt: ", dt, " s is longer than the ", limit.dt, " s up to which particle ",
          limit.particle, " is stable with its mass and ", limit.of,
          "; stable_dt(state, contacts) says what is safe");
}

}  // namespace novaphy
