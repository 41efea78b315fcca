// Computes the tangents of slots, contacts and inertial positions along a direction of the arrays
// of the model and the state.
#include <algorithm>

#include "element_arrays.h"
#include "novaphy/math/dual.h"
#include "novaphy/vbd/contact_numbers_law.h"
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
    const OnHost<Vec3f> q_tangent(t.particle_q), qd_tangent(t.particle_qd), f_tangent(t.particle_f),
        target_tangent(t.targets), gravity_tangent(t.gravity), f(in.f), qd(in.qd);
    const OnHost<float> mass_tangent(t.particle_mass), last_tangent(t.last_velocity);
    const OnHost<VbdRow> last(in.last_velocity);
    const std::vector<Vec3f> gravities = step.model().gravity.to_host();
    size_t kinematic = 0;
    for (size_t p = 0; p < to.x.size(); ++p) {
      const Vec3f start = at(q_tangent.rows, p);
      to.start[p] = start;
      if (step.is_kinematic(p)) {
        to.x[p] = in.targets.rows() != 0 ? at(target_tangent.rows, kinematic) : start;
        ++kinematic;
        continue;
      }
      const int32_t world = m.particle_world.data()[p];
      const float w = inv_mass[p], mass = at(mass_tangent.rows, p);
      const auto of = world < 0 ? worlds - 1 : static_cast<size_t>(world);
      const Vec3f gravity = at(gravity_tangent.rows, of), velocity = at(qd_tangent.rows, p);
      const Vec3f acceleration =
          (gravity + at(f_tangent.rows, p) * w) - f.rows[p] * ((w * w) * mass);
      to.target[p] = start + (velocity + acceleration * h) * h;
      to.guess[p] = previous ? start : Vec3f(to.target[p]);
      if (step.looks_back(in) && last.rows[p].w != 0.0f) {
        const float* const l = last_tangent.rows;
        const Vec3f tangent = {at(l, 4 * p), at(l, 4 * p + 1), at(l, 4 * p + 2)};
        to.guess[p] = start + adaptive_guess_tangent(qd.rows[p], gravities[of], h, last.rows[p],
                                                     velocity, gravity, tangent);
      }
      to.mass[p] = mass / (h * h);
    }
  }

  void set_slots() const {
    using Tangent = math::Dual<float>;
    for_roles([&](auto is) {
      using Slot = typename decltype(is)::Slot;
      const ColorSlots::Table& table = step.slots().table(is.role);
      float* const numbers = to.numbers.data() + step.slots().floats_begin()[is.role];
      const auto lanes = static_cast<size_t>(step.slots().lanes());
      const auto values = parameters_on_host<Slot>(m);
      const auto tangents =
          parameter_arrays<Slot>(t, [](const Array& of) { return OnHost<float>(of); });
      for (size_t k = 0; k < table.sources.size(); ++k) {
        const auto [e, corner] = table.sources[k];
        if (e < 0) continue;
        Tangent p[Slot::kParameters];
        for_parameters<Slot>(e, [&](int n, int array, int64_t at_row) {
          const auto of = static_cast<size_t>(array), row = static_cast<size_t>(at_row);
          p[n] = {at(values[of], row), at(tangents[of].rows, row)};
        });
        float* const tangent = numbers + step.slots().offset_of(is.role, k);
        Slot::put_numbers(corner, p, Tangent(h), [&](int n, const Tangent& number) {
          tangent[static_cast<size_t>(n) * lanes] = number.d;
        });
      }
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
    const OnHost<float> radius(t.particle_radius), margin(t.shape_margin), ke(t.shape_material_ke),
        kd(t.shape_material_kd), mu(t.shape_material_mu);
    to.contacts.resize(items.size() * kContactLawFloats);
    using Tangent = math::Dual<float>;
    const ContactMaterial<Tangent> of_model = {Tangent(), Tangent(), Tangent(model_mu)};
    for (size_t k = 0; k < static_cast<size_t>(begin.back()); ++k) {
      const auto slot = static_cast<size_t>(items[k]);
      const auto p = static_cast<size_t>(particle[slot]), s = static_cast<size_t>(shape[slot]);
      const ContactMaterial<Tangent> of_shape = {
          {0.0f, at(ke.rows, s)}, {0.0f, at(kd.rows, s)}, {friction[s], at(mu.rows, s)}};
      put_contact_law(Tangent(0.0f, at(radius.rows, p) + at(margin.rows, s)), of_model, of_shape,
                      Tangent(h), [&](size_t number, const Tangent& value) {
                        to.contacts[k * kContactLawFloats + number] = value.d;
                      });
    }
  }

 private:
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
  all.numbers.resize(static_cast<size_t>(step.slots().floats_begin().back()));
  const Direction d(all, step, in, direction);
  d.set_state();
  d.set_slots();
  d.set_contacts();
  return all;
}

}  // namespace novaphy::vbd
