// Newton 1.8.0's SolverVBD (cpu): every operation of its kernels in float32 and in its order, so
// that the bits agree. The file is an oracle for tests. The engine has other, closed forms.
//
// Rounding: matrix products are chains of fma, as in Warp. Everything else rounds operation by
// operation. atan2 is that of the C library, as in Warp.
#pragma once

#include <algorithm>
#include <cmath>
#include <span>
#include <vector>

#include "newton_scene.h"
#include "novaphy/math/types.h"

namespace novaphy::testing::newton {

using V = Vec3f;
struct M {
  float m[3][3] = {};
};

inline V operator+(const V& a, const V& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline V operator-(const V& a, const V& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline V operator-(const V& a) { return {-a.x, -a.y, -a.z}; }
inline V operator*(const V& a, float s) { return {a.x * s, a.y * s, a.z * s}; }
inline V operator*(float s, const V& a) { return a * s; }
inline V operator/(const V& a, float s) { return {a.x / s, a.y / s, a.z / s}; }
inline float dot(const V& a, const V& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline float length(const V& a) { return std::sqrt(dot(a, a)); }
inline V cross(const V& a, const V& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

template <class Entry>
M each(const Entry& entry) {
  M r;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) r.m[i][j] = entry(i, j);
  return r;
}
inline M operator+(const M& a, const M& b) {
  return each([&](int i, int j) { return a.m[i][j] + b.m[i][j]; });
}
inline M operator-(const M& a, const M& b) {
  return each([&](int i, int j) { return a.m[i][j] - b.m[i][j]; });
}
inline M operator-(const M& a) {
  return each([&](int i, int j) { return -a.m[i][j]; });
}
inline M operator*(float s, const M& a) {
  return each([&](int i, int j) { return a.m[i][j] * s; });
}
inline M operator/(const M& a, float s) {
  return each([&](int i, int j) { return a.m[i][j] / s; });
}
inline M operator*(const M& a, const M& b) {
  return each([&](int i, int j) {
    float sum = 0.0f;
    for (int k = 0; k < 3; ++k) sum = std::fma(a.m[i][k], b.m[k][j], sum);
    return sum;
  });
}
inline V operator*(const M& a, const V& b) {
  const auto column = [&](int k) { return V{a.m[0][k], a.m[1][k], a.m[2][k]}; };
  return (column(0) * b.x + column(1) * b.y) + column(2) * b.z;
}
inline M transpose(const M& a) {
  return each([&](int i, int j) { return a.m[j][i]; });
}
inline M identity() {
  return each([](int i, int j) { return i == j ? 1.0f : 0.0f; });
}
inline M outer(const V& a, const V& b) {
  const float u[3] = {a.x, a.y, a.z}, v[3] = {b.x, b.y, b.z};
  return each([&](int i, int j) { return u[i] * v[j]; });
}
inline M skew(const V& a) { return {{{0.0f, -a.z, a.y}, {a.z, 0.0f, -a.x}, {-a.y, a.x, 0.0f}}}; }
inline V row(const M& a, int i) { return {a.m[i][0], a.m[i][1], a.m[i][2]}; }
inline M columns(const V& a, const V& b, const V& c) {
  return {{{a.x, b.x, c.x}, {a.y, b.y, c.y}, {a.z, b.z, c.z}}};
}
inline float determinant(const M& a) { return dot(row(a, 0), cross(row(a, 1), row(a, 2))); }
inline M inverse(const M& a) {
  const auto& m = a.m;
  M b;
  b.m[0][0] = m[1][1] * m[2][2] - m[1][2] * m[2][1];
  b.m[1][0] = m[1][2] * m[2][0] - m[1][0] * m[2][2];
  b.m[2][0] = m[1][0] * m[2][1] - m[1][1] * m[2][0];
  b.m[0][1] = m[0][2] * m[2][1] - m[0][1] * m[2][2];
  b.m[1][1] = m[0][0] * m[2][2] - m[0][2] * m[2][0];
  b.m[2][1] = m[0][1] * m[2][0] - m[0][0] * m[2][1];
  b.m[0][2] = m[0][1] * m[1][2] - m[0][2] * m[1][1];
  b.m[1][2] = m[0][2] * m[1][0] - m[0][0] * m[1][2];
  b.m[2][2] = m[0][0] * m[1][1] - m[0][1] * m[1][0];
  return (1.0f / determinant(a)) * b;
}

// The force on one corner of an element, and its Hessian.
struct Unit {
  V f{};
  M h{};
};
inline Unit operator+(const Unit& a, const Unit& b) { return {a.f + b.f, a.h + b.h}; }

// lambda of the stable Neo-Hookean law, and its alpha.
inline float alpha_of(float mu, float ln) {
  const float safe = (ln < 0.0f ? -1.0f : 1.0f) * std::max(std::abs(ln), 1e-6f);
  return 1.0f + mu / safe;
}

// evaluate_neo_hookean_membrane_force_hessian, for corner `order`; positions of the three corners.
inline Unit triangle(int order, const V (&x)[3], const V (&xn)[3], const Mat22f& pose, float area,
                     float mu, float lambda, float damping, float dt) {
  const float d00 = pose.m[0][0], d01 = pose.m[0][1], d10 = pose.m[1][0], d11 = pose.m[1][1];
  const V x01 = x[1] - x[0], x02 = x[2] - x[0];
  const V f0 = x01 * d00 + x02 * d10, f1 = x01 * d01 + x02 * d11;
  const V area_vector = cross(f0, f1);
  const float j = std::sqrt(std::max(dot(area_vector, area_vector), 1e-20f));
  const float inverse_j = 1.0f / j;
  const V normal = area_vector * inverse_j;
  const float ln = lambda + mu, alpha = alpha_of(mu, ln);
  const V g0 = cross(f1, normal), g1 = cross(normal, f0);
  const float s = ln * (j - alpha);
  const V p0 = mu * f0 + s * g0, p1 = mu * f1 + s * g1;
  const float mask[3] = {order == 0 ? 1.0f : 0.0f, order == 1 ? 1.0f : 0.0f,
                         order == 2 ? 1.0f : 0.0f};
  const float a = d00 * (mask[1] - mask[0]) + d10 * (mask[2] - mask[0]);
  const float b = d01 * (mask[1] - mask[0]) + d11 * (mask[2] - mask[0]);
  V force = -(p0 * a + p1 * b);
  const float r = std::max(0.0f, s) * inverse_j, c1 = ln - r;
  const V dj = g0 * a + g1 * b, w = f1 * a - f0 * b;
  const float coefficient = mu * (a * a + b * b) + r * dot(w, w);
  M hessian = (coefficient * identity() + c1 * outer(dj, dj)) - r * outer(w, w);
  if (damping > 0.0f) {
    const float inv_dt = 1.0f / dt;
    const V y01 = xn[1] - xn[0], y02 = xn[2] - xn[0];
    const V n0 = y01 * d00 + y02 * d10, n1 = y01 * d01 + y02 * d11;
    const float c00 = (dot(f0, f0) - dot(n0, n0)) * inv_dt;
    const float c01 = (dot(f0, f1) - dot(n0, n1)) * inv_dt;
    const float c11 = (dot(f1, f1) - dot(n1, n1)) * inv_dt;
    const V e00 = (2.0f * a) * f0, e01 = a * f1 + b * f0, e11 = (2.0f * b) * f1;
    const V damp = (c00 * e00 + (2.0f * c01) * e01) + c11 * e11;
    force = force + (-damping) * damp;
    hessian = hessian +
              (damping * inv_dt) * ((outer(e00, e00) + 2.0f * outer(e01, e01)) + outer(e11, e11));
  }
  return {force * area, area * hessian};
}

// evaluate_dihedral_angle_based_bending_force_hessian.
struct Fold {
  V n1, n2, e;
  float n1_length = 0.0f, n2_length = 0.0f, sine = 0.0f, cosine = 0.0f, angle = 0.0f;
  bool valid = false;
};
inline Fold fold(const V (&x)[4]) {
  Fold f;
  const V n1 = cross(x[2] - x[0], x[3] - x[0]), n2 = cross(x[3] - x[1], x[2] - x[1]),
          e = x[3] - x[2];
  f.n1_length = length(n1);
  f.n2_length = length(n2);
  const float e_length = length(e), least = 1e-6f;
  f.valid = !(f.n1_length < least || f.n2_length < least || e_length < least);
  if (!f.valid) return f;
  f.n1 = n1 / f.n1_length;
  f.n2 = n2 / f.n2_length;
  f.e = e / e_length;
  f.sine = dot(cross(f.n1, f.n2), f.e);
  f.cosine = dot(f.n1, f.n2);
  f.angle = std::atan2(f.sine, f.cosine);
  return f;
}
inline M unit_derivative(float size, const V& unit, const M& derivative) {
  return ((1.0f / size) * (identity() - outer(unit, unit))) * derivative;
}
inline Unit hinge(int order, const V (&x)[4], const V (&xn)[4], float rest, float rest_length,
                  float ke, float kd, float dt) {
  const Fold now = fold(x);
  if (!now.valid) return {};
  M dn1, dn2;
  if (order == 0) dn1 = unit_derivative(now.n1_length, now.n1, skew(x[3] - x[2]));
  if (order == 1) dn2 = unit_derivative(now.n2_length, now.n2, -skew(x[3] - x[2]));
  if (order == 2) {
    dn1 = unit_derivative(now.n1_length, now.n1, -skew(x[3] - x[0]));
    dn2 = unit_derivative(now.n2_length, now.n2, skew(x[3] - x[1]));
  }
  if (order == 3) {
    dn1 = unit_derivative(now.n1_length, now.n1, skew(x[2] - x[0]));
    dn2 = unit_derivative(now.n2_length, now.n2, -skew(x[2] - x[1]));
  }
  const V dsine = transpose(skew(now.n1) * dn2 - skew(now.n2) * dn1) * now.e;
  const V dcosine = transpose(dn1) * now.n2 + transpose(dn2) * now.n1;
  const V t = dsine * now.cosine - dcosine * now.sine;
  const float k = ke * rest_length;
  Unit unit = {-(k * (now.angle - rest)) * t, k * outer(t, t)};
  if (!(kd > 0.0f)) return unit;
  const Fold before = fold(xn);
  if (!before.valid) return unit;
  const float pi = 3.141592653589793f, turn = 6.283185307179586f, inv_dt = 1.0f / dt;
  float change = now.angle - before.angle;
  if (change > pi) {
    change = change - turn;
  } else if (change < -pi) {
    change = change + turn;
  }
  return unit + Unit{((-kd * rest_length) * (change * inv_dt)) * t,
                     ((kd * rest_length) * inv_dt) * outer(t, t)};
}

// evaluate_volumetric_neo_hookean_force_and_hessian, by its 9x9 matrix.
inline Unit tetrahedron(int order, const V (&x)[4], const V (&xn)[4], const M& pose, float mu,
                        float lambda, float damping, float dt) {
  const float volume = 1.0f / (determinant(pose) * 6.0f);
  const M g = columns(x[1] - x[0], x[2] - x[0], x[3] - x[0]) * pose;
  const float j = determinant(g), ln = lambda + mu, s = ln * (j - alpha_of(mu, ln));
  const auto& F = g.m;
  const M cof = {{{F[1][1] * F[2][2] - F[1][2] * F[2][1], F[1][2] * F[2][0] - F[1][0] * F[2][2],
                   F[1][0] * F[2][1] - F[1][1] * F[2][0]},
                  {F[0][2] * F[2][1] - F[0][1] * F[2][2], F[0][0] * F[2][2] - F[0][2] * F[2][0],
                   F[0][1] * F[2][0] - F[0][0] * F[2][1]},
                  {F[0][1] * F[1][2] - F[0][2] * F[1][1], F[0][2] * F[1][0] - F[0][0] * F[1][2],
                   F[0][0] * F[1][1] - F[0][1] * F[1][0]}}};
  float p[9], h9[9][9], c[9];
  for (int k = 0; k < 9; ++k) {
    c[k] = cof.m[k % 3][k / 3];
    p[k] = volume * (mu * F[k % 3][k / 3] + s * c[k]);
  }
  for (int i = 0; i < 9; ++i)
    for (int k = 0; k < 9; ++k)
      h9[i][k] = volume * (mu * (i == k ? 1.0f : 0.0f) + ln * (c[i] * c[k]));
  float m[3];
  for (int k = 0; k < 3; ++k)
    m[k] = order == 0 ? -(pose.m[0][k] + pose.m[1][k] + pose.m[2][k]) : pose.m[order - 1][k];
  const auto force_of = [&](int i) { return -(p[i] * m[0] + p[i + 3] * m[1] + p[i + 6] * m[2]); };
  Unit unit = {{force_of(0), force_of(1), force_of(2)}, {}};
  unit.h = each([&](int i, int k) {
    const auto column = [&](int n) {
      return h9[i][n] * m[0] + h9[i + 3][n] * m[1] + h9[i + 6][n] * m[2];
    };
    return m[0] * column(k) + m[1] * column(k + 3) + m[2] * column(k + 6);
  });
  if (!(damping > 0.0f)) return unit;
  const float inv_dt = 1.0f / dt;
  const M before = columns(xn[1] - xn[0], xn[2] - xn[0], xn[3] - xn[0]) * pose;
  const auto of = [](const M& a, int k) { return V{a.m[0][k], a.m[1][k], a.m[2][k]}; };
  V damp{};
  M sum;
  bool first = true;
  for (int a = 0; a < 3; ++a)
    for (int b = a; b < 3; ++b) {
      const float rate = (dot(of(g, a), of(g, b)) - dot(of(before, a), of(before, b))) * inv_dt;
      const V e = a == b ? (2.0f * m[a]) * of(g, a) : m[a] * of(g, b) + m[b] * of(g, a);
      const V part = (a == b ? rate : 2.0f * rate) * e;
      const M square = a == b ? outer(e, e) : 2.0f * outer(e, e);
      damp = first ? part : damp + part;
      sum = first ? square : sum + square;
      first = false;
    }
  return {unit.f - (volume * damping) * damp, unit.h + ((volume * damping) * inv_dt) * sum};
}

// evaluate_spring_force_and_hessian_both_vertices, for the first end.
inline Unit spring(const V& x0, const V& x1, const V& xn0, const V& xn1, float rest, float ke,
                   float kd, float dt) {
  const V d = x0 - x1;
  const float l = std::max(length(d), 1e-8f), before = std::max(length(xn0 - xn1), 1e-8f);
  const M structural = identity() - (rest / l) * (identity() - outer(d, d) / (l * l));
  const V u = d / l;
  return Unit{((ke * (rest - l)) / l) * d, ke * structural} +
         Unit{(-u) * ((kd / dt) * (l - before)), (kd / dt) * outer(u, u)};
}

// _compute_body_particle_contact_force without its log barrier.
inline Unit contact(float distance, float radius, const V& n, const V& slip, float ke, float kd,
                    float mu, float epsilon, float dt) {
  const float load = ke * (radius - distance);
  Unit unit = {n * load, ke * outer(n, n)};
  if (dot(n, slip) < 0.0f) {
    const M damping = (kd / dt) * outer(n, n);
    unit.h = unit.h + damping;
    unit.f = unit.f - damping * slip;
  }
  const float eps = epsilon * dt;
  const V ut = slip - n * dot(n, slip);
  const float size = length(ut);
  if (!(size > 0.0f)) return unit;
  const float shape = size > eps ? 1.0f / size : (-size / eps + 2.0f) / eps;
  const float scale = (mu * load) * shape;
  return unit + Unit{-(scale * ut), scale * (identity() - outer(n, n))};
}

// A scene of Newton's and its substeps.
class Oracle {
 public:
  explicit Oracle(const NewtonVbdScene& of) : scene_(of) {
    const Npz& file = scene_.file;
    const size_t n = scene_.particles();
    const auto add = [n](std::vector<std::vector<Corner>>& to, std::span<const int32_t> indices,
                         size_t corners) {
      to.resize(n);
      for (size_t k = 0; k < indices.size(); ++k)
        if (indices[k] >= 0)
          to[static_cast<size_t>(indices[k])].push_back(
              {k / corners, static_cast<int>(k % corners)});
    };
    const auto of_model = [&](const char* name) {
      const std::string key = "model_" + std::string(name);
      return file.contains(key) ? file[key].as<int32_t>() : std::span<const int32_t>();
    };
    triangles_ = of_model("tri_indices");
    hinges_ = of_model("edge_indices");
    tetrahedra_ = of_model("tet_indices");
    springs_ = of_model("spring_indices");
    add(of_triangles_, triangles_, 3);
    add(of_hinges_, hinges_, 4);
    add(of_tetrahedra_, tetrahedra_, 4);
  }

  // One substep. `iterates`: the positions after 0, 1, ... iterations; may be null.
  void step(size_t substep, const std::vector<V>& q, const std::vector<V>& qd,
            std::vector<V>& q_out, std::vector<V>& qd_out,
            std::vector<std::vector<V>>* iterates = nullptr) {
    dt_ = scene_.dt();
    xn_ = q;
    x_ = q;
    const size_t n = q.size();
    const auto mass = particle_mass_, w = particle_inv_mass_;
    const auto flags = particle_flags_;
    const V g = column<V>("gravity")[0];
    const Contacts contacts = scene_.contacts(substep);
    std::vector<V> y(n), moved(n);
    const auto held = [&](size_t p) { return (flags[p] & 1) == 0 || w[p] == 0.0f; };
    for (size_t p = 0; p < n; ++p) {
      y[p] = q[p];
      if (held(p)) continue;
      const V v = qd[p] + (g + V{} * w[p]) * dt_;
      y[p] = q[p] + v * dt_;
      moved[p] = v * dt_;
    }
    const auto place = [&] {
      for (size_t p = 0; p < n; ++p) x_[p] = xn_[p] + moved[p];
    };
    place();
    if (iterates != nullptr) iterates->assign(1, x_);
    for (int32_t k = 0; k < scene_.iterations(); ++k) {
      for (const std::vector<int32_t>& color : groups_) {
        std::vector<Unit> outside(n);
        std::vector<uint8_t> in_color(n);
        for (const int32_t p : color) in_color[static_cast<size_t>(p)] = 1;
        add_contacts(contacts, in_color, outside);
        add_springs(in_color, outside);
        for (const int32_t particle : color) {
          const auto p = static_cast<size_t>(particle);
          if (held(p)) {
            moved[p] = V{};
            continue;
          }
          const float inv_h2 = 1.0f / (dt_ * dt_);
          Unit sum = {(mass[p] * (y[p] - x_[p])) * inv_h2, (mass[p] * inv_h2) * identity()};
          sum = sum_elements(p, sum) + outside[p];
          if (std::abs(determinant(sum.h)) > 1e-8f) moved[p] = moved[p] + inverse(sum.h) * sum.f;
        }
        place();
      }
      if (iterates != nullptr) iterates->push_back(x_);
    }
    q_out = x_;
    qd_out.resize(n);
    for (size_t p = 0; p < n; ++p) qd_out[p] = (x_[p] - xn_[p]) / dt_;
  }

 private:
  struct Corner {
    size_t element;
    int order;
  };
  // Returns an array of the model; empty if the model has no such elements.
  template <class T>
  std::span<const T> column(const char* name) const {
    const std::string key = "model_" + std::string(name);
    return scene_.file.contains(key) ? scene_.file[key].as<T>() : std::span<const T>();
  }
  template <size_t n>
  void corners(std::span<const int32_t> indices, size_t element, V (&x)[n], V (&xn)[n]) const {
    for (size_t c = 0; c < n; ++c) {
      const auto p = static_cast<size_t>(indices[n * element + c]);
      x[c] = x_[p];
      xn[c] = xn_[p];
    }
  }

  void add_contacts(const Contacts& contacts, const std::vector<uint8_t>& in_color,
                    std::vector<Unit>& sums) const {
    const auto material = scene_.file["contact_ke_kd_mu"].as<V>();
    const float epsilon = scene_.file["solver_friction_epsilon"].scalar<float>();
    for (int32_t k = 0; k < *contacts.soft_contact_count.data(); ++k) {
      const auto p = static_cast<size_t>(contacts.soft_contact_particle.data()[k]);
      const auto s = static_cast<size_t>(contacts.soft_contact_shape.data()[k]);
      if (in_color[p] == 0) continue;
      const V n = contacts.soft_contact_normal.data()[k];
      const float distance = dot(n, x_[p] - contacts.soft_contact_body_pos.data()[k]);
      const float radius = particle_radius_[p] + shape_margin_[s];
      if (!(radius - distance > 0.0f)) continue;
      sums[p] = sums[p] + contact(distance, radius, n, x_[p] - xn_[p], material[s].x, material[s].y,
                                  material[s].z, epsilon, dt_);
    }
  }
  void add_springs(const std::vector<uint8_t>& in_color, std::vector<Unit>& sums) const {
    for (size_t e = 0; e < springs_.size() / 2; ++e) {
      const auto a = static_cast<size_t>(springs_[2 * e]),
                 b = static_cast<size_t>(springs_[2 * e + 1]);
      const Unit unit = spring(x_[a], x_[b], xn_[a], xn_[b], spring_rest_length_[e],
                               spring_stiffness_[e], spring_damping_[e], dt_);
      if (in_color[a] != 0) sums[a] = sums[a] + unit;
      if (in_color[b] != 0) sums[b] = sums[b] + Unit{-unit.f, unit.h};
    }
  }
  Unit sum_elements(size_t p, Unit sum) const {
    for (const auto& [e, order] : of_triangles_[p]) {
      const float* const c = tri_materials_.data() + 5 * e;
      if (!(c[0] > 0.0f || c[1] > 0.0f)) continue;
      V x[3], xn[3];
      corners(triangles_, e, x, xn);
      sum = sum + triangle(order, x, xn, tri_poses_[e], tri_areas_[e], c[0], c[1], c[2], dt_);
    }
    for (const auto& [e, order] : of_hinges_[p]) {
      const float* const c = edge_bending_properties_.data() + 2 * e;
      if (!(c[0] > 0.0f) || hinges_[4 * e] < 0 || hinges_[4 * e + 1] < 0) continue;
      V x[4], xn[4];
      corners(hinges_, e, x, xn);
      sum = sum + hinge(order, x, xn, edge_rest_angle_[e], edge_rest_length_[e], c[0], c[1], dt_);
    }
    for (const auto& [e, order] : of_tetrahedra_[p]) {
      const float* const c = tet_materials_.data() + 3 * e;
      if (!(c[0] > 0.0f || c[1] > 0.0f)) continue;
      V x[4], xn[4];
      corners(tetrahedra_, e, x, xn);
      sum = sum + tetrahedron(order, x, xn, tet_poses_[e], c[0], c[1], c[2], dt_);
    }
    return sum;
  }

  const NewtonVbdScene& scene_;
  std::span<const float> particle_mass_ = column<float>("particle_mass");
  std::span<const float> particle_inv_mass_ = column<float>("particle_inv_mass");
  std::span<const int32_t> particle_flags_ = column<int32_t>("particle_flags");
  std::span<const float> particle_radius_ = column<float>("particle_radius");
  std::span<const float> shape_margin_ = column<float>("shape_margin");
  std::span<const float> spring_rest_length_ = column<float>("spring_rest_length");
  std::span<const float> spring_stiffness_ = column<float>("spring_stiffness");
  std::span<const float> spring_damping_ = column<float>("spring_damping");
  std::span<const float> tri_materials_ = column<float>("tri_materials");
  std::span<const Mat22f> tri_poses_ = column<Mat22f>("tri_poses");
  std::span<const float> tri_areas_ = column<float>("tri_areas");
  std::span<const float> edge_bending_properties_ = column<float>("edge_bending_properties");
  std::span<const float> edge_rest_angle_ = column<float>("edge_rest_angle");
  std::span<const float> edge_rest_length_ = column<float>("edge_rest_length");
  std::span<const float> tet_materials_ = column<float>("tet_materials");
  std::span<const M> tet_poses_ = column<M>("tet_poses");
  const std::vector<std::vector<int32_t>> groups_ = scene_.groups();
  std::span<const int32_t> triangles_, hinges_, tetrahedra_, springs_;
  std::vector<std::vector<Corner>> of_triangles_, of_hinges_, of_tetrahedra_;
  std::vector<V> x_, xn_;
  float dt_ = 0.0f;
};

}  // namespace novaphy::testing::newton
