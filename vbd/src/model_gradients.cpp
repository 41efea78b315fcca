// The derivatives of a scalar by the arrays of the model and the state.
#include <algorithm>
#include <cmath>

#include "model_derivatives.h"
#include "novaphy/math/matrix.h"

namespace novaphy::vbd {
namespace {

void put(float* to, size_t row, float value) {
  if (to != nullptr) to[row] = value;
}

class Gradients {
 public:
  Gradients(const ReversePass& from, const VbdStepInputs& inputs, const VbdStepGradients& to)
      : pass(from), in(inputs), g(to), m(from.step.model), h(inputs.dt) {}

  void put_state() const {
    const float* const inv_mass = m.particle_inv_mass.data();
    const auto worlds = static_cast<size_t>(m.world_count());
    for (size_t w = 0; g.gravity != nullptr && w < worlds; ++w) g.gravity[w] = {};
    size_t held = 0;
    for (size_t p = 0; p < pass.x_bar.size(); ++p) {
      const bool is_held = pass.step.slots.is_held(static_cast<int32_t>(p));
      const Vec3f by_target = pass.target_bar[p];
      Vec3f by_start = Vec3f(pass.start_bar[p]) + by_target;
      if (is_held) {
        const Vec3f by_place = pass.x_bar[p];
        if (in.targets == nullptr) by_start = by_start + by_place;
        if (g.targets != nullptr) g.targets[held] = in.targets != nullptr ? by_place : Vec3f{};
        ++held;
      }
      if (g.particle_q != nullptr) g.particle_q[p] = by_start;
      if (g.particle_qd != nullptr) g.particle_qd[p] = by_target * h;
      if (g.particle_f != nullptr) g.particle_f[p] = by_target * ((h * h) * inv_mass[p]);
      if (g.gravity != nullptr) {
        const int32_t world = m.particle_world.data()[p];
        Vec3f& by_gravity = g.gravity[world < 0 ? worlds - 1 : static_cast<size_t>(world)];
        by_gravity = by_gravity + by_target * (h * h);
      }
      // m/h^2, and 1/m in the target.
      const float w = inv_mass[p];
      const float by_inverse = math::dot(by_target, in.particle_f[p]) * (h * h);
      put(g.particle_mass, p, is_held ? 0.0f : pass.mass_bar[p] / (h * h) - (w * w) * by_inverse);
    }
  }

  void put_springs() const {
    for (size_t e = 0; e < m.particle_spring_indices.rows(); ++e) {
      put(g.particle_spring_stiffness, e, pass.law_bar(kSpring, e, 0));
      put(g.particle_spring_damping, e, pass.law_bar(kSpring, e, 1) / h);
      put(g.particle_spring_rest_length, e, pass.law_bar(kSpring, e, 2));
    }
  }

  void put_edges() const {
    for (size_t e = 0; e < m.particle_edge_indices.rows(); ++e) {
      const auto bar = [&](int k) {
        return pass.law_bar(kHingeOpposite, e, k) + pass.law_bar(kHingeEnd, e, k);
      };
      const float* const c = m.particle_edge_material.data() + 2 * e;
      const float length = m.particle_edge_rest_length.data()[e];
      put(g.particle_edge_material, 2 * e, length * bar(0));
      put(g.particle_edge_material, 2 * e + 1, (length / h) * bar(1));
      put(g.particle_edge_rest_angle, e, bar(2));
      put(g.particle_edge_rest_length, e, c[0] * bar(0) + (c[1] / h) * bar(1));
    }
  }

  void put_triangles() const {
    for (size_t e = 0; e < m.particle_tri_indices.rows(); ++e) {
      float* const to =
          g.particle_tri_material != nullptr ? g.particle_tri_material + 5 * e : nullptr;
      const float by_area = put_elastic(
          kTriangle, e, m.particle_tri_area.data()[e], m.particle_tri_material.data() + 5 * e, to,
          g.particle_tri_activation != nullptr ? g.particle_tri_activation + e : nullptr);
      if (to != nullptr) to[3] = to[4] = 0.0f;
      put(g.particle_tri_area, e, by_area);
      if (g.particle_tri_pose != nullptr) put_pose<2>(kTriangle, e, g.particle_tri_pose + 4 * e);
    }
  }

  void put_tetrahedra() const {
    for (size_t e = 0; e < m.particle_tet_indices.rows(); ++e) {
      const Mat33f& pose = m.particle_tet_pose.data()[e];
      const float volume = 1.0f / (math::determinant(pose) * 6.0f);
      const float by_volume = put_elastic(
          kTetrahedron, e, volume, m.particle_tet_material.data() + 3 * e,
          g.particle_tet_material != nullptr ? g.particle_tet_material + 3 * e : nullptr,
          g.particle_tet_activation != nullptr ? g.particle_tet_activation + e : nullptr);
      if (g.particle_tet_pose == nullptr) continue;
      float* const to = g.particle_tet_pose + 9 * e;
      put_pose<3>(kTetrahedron, e, to);
      // The volume is 1/(6 det), and the derivative of det by a row is the cross product of the
      // others.
      const float by_det = -(by_volume * volume) * (volume * 6.0f);
      for (int row = 0; row < 3; ++row) {
        const Vec3f v = math::cross(math::row(pose, (row + 1) % 3), math::row(pose, (row + 2) % 3));
        const float of_row[3] = {v.x, v.y, v.z};
        for (int c = 0; c < 3; ++c) to[3 * row + c] += by_det * of_row[c];
      }
    }
  }

  void put_contacts() const {
    const auto clear = [](float* rows, int32_t count) {
      if (rows != nullptr) std::fill(rows, rows + count, 0.0f);
    };
    clear(g.particle_radius, m.particle_count());
    for (float* rows :
         {g.shape_margin, g.shape_material_ke, g.shape_material_kd, g.shape_material_mu})
      clear(rows, m.shape_count());
    const auto add = [](float* rows, int32_t row, float value) {
      if (rows != nullptr) rows[row] += value;
    };
    const float* bar = pass.contact_bars.data();
    for (const int32_t slot : pass.step.contacts.slots()) {
      const int32_t particle = in.contacts->soft_contact_particle.data()[slot];
      const int32_t shape = in.contacts->soft_contact_shape.data()[slot];
      add(g.particle_radius, particle, bar[0]);
      add(g.shape_margin, shape, bar[0]);
      add(g.shape_material_ke, shape, 0.5f * bar[1]);
      add(g.shape_material_kd, shape, (0.5f * bar[2]) / h);
      const float mean = std::sqrt(m.soft_contact_mu * m.shape_material_mu.data()[shape]);
      if (mean > 0.0f)
        add(g.shape_material_mu, shape, bar[3] * (m.soft_contact_mu / (2.0f * mean)));
      bar += kContactLawFloats;
    }
  }

 private:
  // Of a Neo-Hookean law whose numbers are size times mu, size times ln, alpha, size times kd/h: by
  // its material (3 columns) and activation. Returns that by the size.
  float put_elastic(Role role, size_t e, float size, const float* material, float* to,
                    float* activation) const {
    const float mu = material[0], ln = material[0] + material[1];
    const float by_mu = pass.law_bar(role, e, 0), by_ln = pass.law_bar(role, e, 1),
                by_alpha = pass.law_bar(role, e, 2), by_kd = pass.law_bar(role, e, 3);
    const float inverse = 1.0f / std::max(ln, 1e-6f);
    const float by_lambda = ln > 1e-6f ? -(mu * inverse) * inverse : 0.0f;
    if (to != nullptr) {
      to[0] = (size * by_mu + size * by_ln) + by_alpha * (inverse + by_lambda);
      to[1] = size * by_ln + by_alpha * by_lambda;
      to[2] = (size / h) * by_kd;
    }
    if (activation != nullptr) *activation = -by_alpha;
    return (mu * by_mu + ln * by_ln) + (material[2] / h) * by_kd;
  }

  // By the inverse rest matrix, {n, n}: its row r is the weight of corner r + 1; that of corner 0
  // is minus their sum. A slot of corner c has the weights of the corners c + 1, c + 2, ...
  template <int n>
  void put_pose(Role role, size_t e, float* to) const {
    float by_corner[n + 1][n] = {};
    for (int c = 0; c <= n; ++c)
      for (int k = 0; k < n; ++k)
        for (int column = 0; column < n; ++column)
          by_corner[(c + 1 + k) % (n + 1)][column] +=
              pass.weight_bar(role, e, static_cast<size_t>(c), n * k + column);
    for (int row = 0; row < n; ++row)
      for (int column = 0; column < n; ++column)
        to[n * row + column] = by_corner[row + 1][column] - by_corner[0][column];
  }

  const ReversePass& pass;
  const VbdStepInputs& in;
  const VbdStepGradients& g;
  const Model& m;
  float h;
};

}  // namespace

bool wants_weights(const VbdStepGradients& g) {
  return g.particle_tri_pose != nullptr || g.particle_tet_pose != nullptr;
}

void put_gradients(const ReversePass& pass, const VbdStepInputs& inputs,
                   const VbdStepGradients& gradients) {
  const Gradients g(pass, inputs, gradients);
  g.put_state();
  g.put_springs();
  g.put_triangles();
  g.put_edges();
  g.put_tetrahedra();
  g.put_contacts();
}

}  // namespace novaphy::vbd
