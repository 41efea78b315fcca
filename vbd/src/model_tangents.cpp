// What slots, contacts and targets change by along a direction of the arrays of the model and the
// state.
#include <algorithm>
#include <cmath>

#include "model_derivatives.h"
#include "novaphy/math/matrix.h"
#include "novaphy/vbd/particle_step_trace.h"

namespace novaphy::vbd {
namespace {

float at(const float* rows, size_t row) { return rows != nullptr ? rows[row] : 0.0f; }
Vec3f at(const Vec3f* rows, size_t row) { return rows != nullptr ? rows[row] : Vec3f{}; }

class Direction {
 public:
  Direction(TangentPass& to, const VbdStepInputs& inputs, const VbdStepTangents& direction)
      : pass(to), in(inputs), t(direction), m(to.step.model), h(inputs.dt) {}

  void set_state() const {
    const float* const inv_mass = m.particle_inv_mass.data();
    const auto worlds = static_cast<size_t>(m.world_count());
    const bool previous = pass.step.options.initial_guess == VbdInitialGuess::Previous;
    size_t held = 0;
    for (size_t p = 0; p < pass.x_slope.size(); ++p) {
      const Vec3f start = at(t.particle_q, p);
      pass.start_slope[p] = start;
      if (pass.step.slots.is_held(static_cast<int32_t>(p))) {
        pass.x_slope[p] = in.targets != nullptr ? at(t.targets, held) : start;
        ++held;
        continue;
      }
      const int32_t world = m.particle_world.data()[p];
      const float w = inv_mass[p], mass = at(t.particle_mass, p);
      const auto of = world < 0 ? worlds - 1 : static_cast<size_t>(world);
      const Vec3f gravity = at(t.gravity, of), velocity = at(t.particle_qd, p);
      const Vec3f acceleration =
          (gravity + at(t.particle_f, p) * w) - in.particle_f[p] * ((w * w) * mass);
      pass.target_slope[p] = start + (velocity + acceleration * h) * h;
      pass.guess_slope[p] = previous ? start : Vec3f(pass.target_slope[p]);
      if (pass.step.looked_back() && in.last_velocity[p].w != 0.0f) {
        const Vec4f last = in.last_velocity[p];
        const Vec3f slope = {at(t.last_velocity, 4 * p), at(t.last_velocity, 4 * p + 1),
                             at(t.last_velocity, 4 * p + 2)};
        pass.guess_slope[p] =
            start + adaptive_guess_slope(in.particle_qd[p], m.gravity.data()[of], h,
                                         {last.x, last.y, last.z}, velocity, gravity, slope);
      }
      pass.mass_slope[p] = mass / (h * h);
    }
  }

  void set_slots() const {
    for_lanes(kSpring, [&](const ColorSlots::Source& s, auto number) {
      const auto e = static_cast<size_t>(s.element);
      number(0) = at(t.particle_spring_stiffness, e);
      number(1) = at(t.particle_spring_damping, e) / h;
      number(2) = at(t.particle_spring_rest_length, e);
    });
    for (const Role role : {kHingeOpposite, kHingeEnd})
      for_lanes(role, [&](const ColorSlots::Source& s, auto number) {
        const auto e = static_cast<size_t>(s.element);
        const float* const c = m.particle_edge_material.data() + 2 * e;
        const float length = m.particle_edge_rest_length.data()[e];
        const float slope = at(t.particle_edge_rest_length, e);
        number(0) = at(t.particle_edge_material, 2 * e) * length + c[0] * slope;
        number(1) = (at(t.particle_edge_material, 2 * e + 1) * length + c[1] * slope) / h;
        number(2) = at(t.particle_edge_rest_angle, e);
      });
    for_lanes(kTriangle, [&](const ColorSlots::Source& s, auto number) {
      const auto e = static_cast<size_t>(s.element);
      set_weights<2>(s, t.particle_tri_pose, number);
      set_elastic(m.particle_tri_area.data()[e], at(t.particle_tri_area, e),
                  m.particle_tri_material.data() + 5 * e, t.particle_tri_material, 5 * e,
                  at(t.particle_tri_activation, e), number, law_begin(kTriangle));
    });
    for_lanes(kTetrahedron, [&](const ColorSlots::Source& s, auto number) {
      const auto e = static_cast<size_t>(s.element);
      const Mat33f& pose = m.particle_tet_pose.data()[e];
      set_weights<3>(s, t.particle_tet_pose, number);
      const float volume = 1.0f / (math::determinant(pose) * 6.0f);
      float det_slope = 0.0f;
      for (size_t row = 0; row < 3; ++row) {
        const auto r = static_cast<int>(row);
        const Vec3f v = math::cross(math::row(pose, (r + 1) % 3), math::row(pose, (r + 2) % 3));
        const size_t first = 9 * e + 3 * row;
        det_slope +=
            math::dot(v, Vec3f{at(t.particle_tet_pose, first), at(t.particle_tet_pose, first + 1),
                               at(t.particle_tet_pose, first + 2)});
      }
      set_elastic(volume, -(volume * 6.0f) * (volume * det_slope),
                  m.particle_tet_material.data() + 3 * e, t.particle_tet_material, 3 * e,
                  at(t.particle_tet_activation, e), number, law_begin(kTetrahedron));
    });
  }

  void set_contacts() const {
    float* slope = pass.contact_slopes.data();
    for (const int32_t slot : pass.step.contacts.slots()) {
      const auto p = static_cast<size_t>(in.contacts->soft_contact_particle.data()[slot]);
      const auto s = static_cast<size_t>(in.contacts->soft_contact_shape.data()[slot]);
      const float mean = std::sqrt(m.soft_contact_mu * m.shape_material_mu.data()[s]);
      *slope++ = at(t.particle_radius, p) + at(t.shape_margin, s);
      *slope++ = 0.5f * at(t.shape_material_ke, s);
      *slope++ = (0.5f * at(t.shape_material_kd, s)) / h;
      *slope++ =
          mean > 0.0f ? at(t.shape_material_mu, s) * (m.soft_contact_mu / (2.0f * mean)) : 0.0f;
    }
  }

 private:
  // Calls set(source, number) for every lane of every slot; number(k) is the slope of its k-th.
  template <class Set>
  void for_lanes(Role role, const Set& set) const {
    const ColorSlots::Table& table = pass.step.slots.table(role);
    const auto lanes = static_cast<size_t>(pass.step.level.lanes);
    for (size_t k = 0; k < table.sources.size(); ++k) {
      if (table.sources[k].element < 0) continue;
      float* const row = pass.number_slopes[role].data() +
                         k / lanes * lanes * static_cast<size_t>(kFloats[role]) + k % lanes;
      set(table.sources[k],
          [row, lanes](int n) -> float& { return row[static_cast<size_t>(n) * lanes]; });
    }
  }

  template <int n, class Numbers>
  static void set_weights(const ColorSlots::Source& s, const float* pose, const Numbers& number) {
    if (pose == nullptr) return;
    const float* const row = pose + static_cast<ptrdiff_t>(s.element) * n * n;
    for (int k = 0; k < n; ++k) {
      const int corner = (s.corner + 1 + k) % (n + 1);
      for (int c = 0; c < n; ++c) {
        float value = 0.0f;
        if (corner > 0) {
          value = row[n * (corner - 1) + c];
        } else {
          for (int r = 0; r < n; ++r) value -= row[n * r + c];
        }
        number(n * k + c) = value;
      }
    }
  }

  // See put_elastic in model_gradients.cpp.
  template <class Numbers>
  void set_elastic(float size, float size_slope, const float* material, const float* slopes,
                   size_t row, float activation_slope, const Numbers& number, int first) const {
    const float mu = material[0], ln = material[0] + material[1];
    const float mu_slope = at(slopes, row), ln_slope = mu_slope + at(slopes, row + 1);
    const float inverse = 1.0f / std::max(ln, 1e-6f);
    number(first) = size * mu_slope + size_slope * mu;
    number(first + 1) = size * ln_slope + size_slope * ln;
    number(first + 2) =
        (mu_slope * inverse - (ln > 1e-6f ? ((mu * inverse) * inverse) * ln_slope : 0.0f)) -
        activation_slope;
    number(first + 3) = (size * at(slopes, row + 2) + size_slope * material[2]) / h;
  }

  TangentPass& pass;
  const VbdStepInputs& in;
  const VbdStepTangents& t;
  const Model& m;
  float h;
};

}  // namespace

void set_direction(TangentPass& pass, const VbdStepInputs& inputs,
                   const VbdStepTangents& direction) {
  const Direction d(pass, inputs, direction);
  d.set_state();
  d.set_slots();
  d.set_contacts();
}

}  // namespace novaphy::vbd
