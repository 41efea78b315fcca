// What slots, contacts and targets change by along a direction of the arrays of the model and the
// state.
#include <algorithm>
#include <cmath>

#include "novaphy/math/matrix.h"
#include "novaphy/vbd/particle_step_law.h"
#include "step_tangent.h"

namespace novaphy::vbd {
namespace {

float at(const float* rows, size_t row) { return rows != nullptr ? rows[row] : 0.0f; }
Vec3f at(const Vec3f* rows, size_t row) { return rows != nullptr ? rows[row] : Vec3f{}; }

class Direction {
 public:
  Direction(SweepTangents& all, const Step& of, const StepInputs& inputs,
            const StepDerivatives& direction)
      : to(all), step(of), in(inputs), t(direction), m(of.host_model()), h(inputs.dt) {}

  void set_state() const {
    const float* const inv_mass = m.particle_inv_mass.data();
    const auto worlds = static_cast<size_t>(m.world_count());
    const bool previous = step.options().initial_guess == VbdInitialGuess::Previous;
    const OnHost q_slope(t.particle_q), qd_slope(t.particle_qd), f_slope(t.particle_f),
        target_slope(t.targets), gravity_slope(t.gravity);
    const OnHost f(in.f), qd(in.qd);
    const OnHost mass_slope(t.particle_mass), last_slope(t.last_velocity);
    const OnHost last(in.last_velocity);
    const std::vector<Vec3f> gravities = step.model().gravity.to_host();
    size_t held = 0;
    for (size_t p = 0; p < to.x.size(); ++p) {
      const Vec3f start = at(q_slope.rows, p);
      to.start[p] = start;
      if (step.is_held(p)) {
        to.x[p] = in.targets.word() != 0 ? at(target_slope.rows, held) : start;
        ++held;
        continue;
      }
      const int32_t world = m.particle_world.data()[p];
      const float w = inv_mass[p], mass = at(mass_slope.rows, p);
      const auto of = world < 0 ? worlds - 1 : static_cast<size_t>(world);
      const Vec3f gravity = at(gravity_slope.rows, of), velocity = at(qd_slope.rows, p);
      const Vec3f acceleration = (gravity + at(f_slope.rows, p) * w) - f.rows[p] * ((w * w) * mass);
      to.target[p] = start + (velocity + acceleration * h) * h;
      to.guess[p] = previous ? start : Vec3f(to.target[p]);
      if (step.looks_back(in) && last.rows[p].w != 0.0f) {
        const float* const l = last_slope.rows;
        const Vec3f slope = {at(l, 4 * p), at(l, 4 * p + 1), at(l, 4 * p + 2)};
        to.guess[p] = start + adaptive_guess_slope(qd.rows[p], gravities[of], h, last.rows[p],
                                                   velocity, gravity, slope);
      }
      to.mass[p] = mass / (h * h);
    }
  }

  void set_slots() const {
    const OnHost particle_edge_material(t.particle_edge_material);
    const OnHost particle_edge_rest_angle(t.particle_edge_rest_angle);
    const OnHost particle_edge_rest_length(t.particle_edge_rest_length);
    const OnHost particle_spring_damping(t.particle_spring_damping);
    const OnHost particle_spring_rest_length(t.particle_spring_rest_length);
    const OnHost particle_spring_stiffness(t.particle_spring_stiffness);
    const OnHost particle_tet_activation(t.particle_tet_activation);
    const OnHost particle_tet_material(t.particle_tet_material);
    const OnHost particle_tet_pose(t.particle_tet_pose);
    const OnHost particle_tri_activation(t.particle_tri_activation);
    const OnHost particle_tri_area(t.particle_tri_area);
    const OnHost particle_tri_material(t.particle_tri_material);
    const OnHost particle_tri_pose(t.particle_tri_pose);
    for_lanes(kSpring, [&](const ColorSlots::Source& s, auto number) {
      const auto e = static_cast<size_t>(s.element);
      number(0) = at(particle_spring_stiffness.rows, e);
      number(1) = at(particle_spring_damping.rows, e) / h;
      number(2) = at(particle_spring_rest_length.rows, e);
    });
    for (const Role role : {kHingeOpposite, kHingeEnd})
      for_lanes(role, [&](const ColorSlots::Source& s, auto number) {
        const auto e = static_cast<size_t>(s.element);
        const float* const c = m.particle_edge_material.data() + 2 * e;
        const float length = m.particle_edge_rest_length.data()[e];
        const float slope = at(particle_edge_rest_length.rows, e);
        number(0) = at(particle_edge_material.rows, 2 * e) * length + c[0] * slope;
        number(1) = (at(particle_edge_material.rows, 2 * e + 1) * length + c[1] * slope) / h;
        number(2) = at(particle_edge_rest_angle.rows, e);
      });
    for_lanes(kTriangle, [&](const ColorSlots::Source& s, auto number) {
      const auto e = static_cast<size_t>(s.element);
      set_weights<2>(s, particle_tri_pose.rows, number);
      set_elastic(m.particle_tri_area.data()[e], at(particle_tri_area.rows, e),
                  m.particle_tri_material.data() + 5 * e, particle_tri_material.rows, 5 * e,
                  at(particle_tri_activation.rows, e), number, law_begin(kTriangle));
    });
    for_lanes(kTetrahedron, [&](const ColorSlots::Source& s, auto number) {
      const auto e = static_cast<size_t>(s.element);
      const Mat33f& pose = m.particle_tet_pose.data()[e];
      set_weights<3>(s, particle_tet_pose.rows, number);
      const float volume = 1.0f / (math::determinant(pose) * 6.0f);
      float det_slope = 0.0f;
      for (size_t row = 0; row < 3; ++row) {
        const auto r = static_cast<int>(row);
        const Vec3f v = math::cross(math::row(pose, (r + 1) % 3), math::row(pose, (r + 2) % 3));
        const size_t first = 9 * e + 3 * row;
        det_slope += math::dot(
            v, Vec3f{at(particle_tet_pose.rows, first), at(particle_tet_pose.rows, first + 1),
                     at(particle_tet_pose.rows, first + 2)});
      }
      set_elastic(volume, -(volume * 6.0f) * (volume * det_slope),
                  m.particle_tet_material.data() + 3 * e, particle_tet_material.rows, 3 * e,
                  at(particle_tet_activation.rows, e), number, law_begin(kTetrahedron));
    });
  }

  void set_contacts() const {
    if (!step.has_contacts()) return;
    const std::vector<int32_t> begin = step.contact_begin().to_host(),
                               items = step.contact_items().to_host(),
                               particle = in.contacts->soft_contact_particle.to_host(),
                               shape = in.contacts->soft_contact_shape.to_host();
    const std::vector<float> friction = step.model().shape_material_mu.to_host();
    const float model_mu = step.model().soft_contact_mu;
    const OnHost radius(t.particle_radius), margin(t.shape_margin), ke(t.shape_material_ke),
        kd(t.shape_material_kd), mu(t.shape_material_mu);
    to.contacts.resize(items.size() * kContactLawFloats);
    float* slope = to.contacts.data();
    for (size_t k = 0; k < static_cast<size_t>(begin.back()); ++k) {
      const auto slot = static_cast<size_t>(items[k]);
      const auto p = static_cast<size_t>(particle[slot]), s = static_cast<size_t>(shape[slot]);
      const float mean = std::sqrt(model_mu * friction[s]);
      *slope++ = at(radius.rows, p) + at(margin.rows, s);
      *slope++ = 0.5f * at(ke.rows, s);
      *slope++ = (0.5f * at(kd.rows, s)) / h;
      *slope++ = mean > 0.0f ? at(mu.rows, s) * (model_mu / (2.0f * mean)) : 0.0f;
    }
  }

 private:
  // Calls set(source, number) for every lane of every slot; number(k) is the slope of its k-th.
  template <class Set>
  void for_lanes(Role role, const Set& set) const {
    const ColorSlots::Table& table = step.slots().table(role);
    const auto lanes = static_cast<size_t>(step.slots().lanes());
    size_t first = 0;
    for (int before = 0; before < role; ++before)
      first += step.slots().table(static_cast<Role>(before)).floats.size();
    for (size_t k = 0; k < table.sources.size(); ++k) {
      if (table.sources[k].element < 0) continue;
      float* const row = to.numbers.data() + first +
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

  // See put_elastic in vbd_gradient_kernels.h.
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

  SweepTangents& to;
  const Step& step;
  const StepInputs& in;
  const StepDerivatives& t;
  const Model& m;
  float h;
};

}  // namespace

SweepTangents tangents_along(const Step& step, const StepInputs& in,
                             const StepDerivatives& direction) {
  const size_t n = step.x().rows();
  SweepTangents all;
  for (Rows* rows : {&all.x, &all.start, &all.target, &all.guess}) rows->resize(n);
  all.mass.resize(n);
  size_t numbers = 0;
  for (int role = 0; role < kRoles; ++role)
    numbers += step.slots().table(static_cast<Role>(role)).floats.size();
  all.numbers.resize(numbers);
  const Direction d(all, step, in, direction);
  d.set_state();
  d.set_slots();
  d.set_contacts();
  return all;
}

}  // namespace novaphy::vbd
