// Computes the derivatives with respect to the arrays of the model and the state from the adjoints
// of slots, contacts and inertial positions.
#include <algorithm>
#include <array>

#include "element_arrays.h"
#include "novaphy/core/builtin_kernels.h"
#include "step_adjoint.h"

namespace novaphy::vbd {
namespace {

template <class... D>
bool any(const D&... derivatives) {
  return ((derivatives.rows() != 0) || ...);
}

}  // namespace

void StepAdjoint::put(const StepInputs& in, const StepDerivatives& g) const {
  put_state(in, g);
  put_elements(g);
  put_contacts(in, g);
}

void StepAdjoint::put_state(const StepInputs& in, const StepDerivatives& g) const {
  const Model& m = step_.model();
  const bool guessed = !key_.at_solution && step_.looks_back(in);
  if (any(g.particle_q, g.particle_qd, g.particle_f, g.particle_mass, g.gravity, g.last_velocity))
    novaphy::run(kernels().particle_gradient, m.particle_count(),
                 {.is_kinematic = step_.is_kinematic(),
                  .inv_mass = m.particle_inv_mass,
                  .f = in.f,
                  .x_adjoint = x_bar_,
                  .start_adjoint = start_bar_,
                  .target_adjoint = target_bar_,
                  .mass_adjoint = mass_adjoint_,
                  .h = step_.dt(),
                  .have_targets = int{in.targets.rows() != 0},
                  .by_q = if_any(g.particle_q),
                  .by_qd = if_any(g.particle_qd),
                  .by_f = if_any(g.particle_f),
                  .by_mass = if_any(g.particle_mass),
                  .by_gravity = any(g.gravity) ? &gravity_bar_ : nullptr,
                  .by_last = if_any(g.last_velocity),
                  .last = guessed ? &in.last_velocity : nullptr,
                  .qd = in.qd,
                  .world = m.particle_world,
                  .gravity = m.gravity,
                  .last_world = m.world_count() - 1});
  if (any(g.targets))
    novaphy::run(kernels().target_gradient, step_.kinematic_count(),
                 {.kinematic = step_.kinematic(),
                  .x_adjoint = x_bar_,
                  .has_targets = int{in.targets.rows() != 0},
                  .by_targets = if_any(g.targets)});
  if (any(g.gravity))
    novaphy::run(kernels().gravity_gradient, m.world_count(),
                 {.begin = tables_.world_begin,
                  .particles = tables_.of_worlds,
                  .of_particles = gravity_bar_,
                  .by_gravity = if_any(g.gravity)});
}

// Passes no activation to the kernel, because no derivative depends on the activation.
void StepAdjoint::put_elements(const StepDerivatives& g) const {
  for_each_kind([&](auto is) {
    using Element = typename decltype(is)::Slot;
    constexpr int first = decltype(is)::role, last = first + Element::kSlots - 1;
    const auto to = parameter_arrays<Element>(g, [](const Array& by) { return if_any(by); });
    if (std::all_of(to.begin(), to.end(), [](const Untyped& by) { return by.word == 0; })) return;
    const DeviceArray<uint64_t>& places = tables_.places[first];
    const std::vector<int64_t>& begins = step_.slots().floats_begin();
    novaphy::run(
        kernels().element_gradient, static_cast<int64_t>(places.rows() / Element::kCorners),
        {.places = std::array{&places, &tables_.places[last]},
         .first = std::array{begins[first], begins[last]},
         .numbers = numbers_,
         .role = first,
         .lanes = step_.slots().lanes(),
         .h = step_.dt(),
         .parameters =
             parameter_arrays<Element>(step_.model(), [](const Array& of) { return Untyped(of); }),
         .to = to});
  });
}

void StepAdjoint::put_contacts(const StepInputs& in, const StepDerivatives& g) const {
  const Model& m = step_.model();
  const bool with_contacts = key_.with_contacts;
  if (any(g.particle_radius))
    novaphy::run(kernels().radius_gradient, m.particle_count(),
                 {.contact_begin = with_contacts ? &step_.contact_begin() : nullptr,
                  .contact_adjoints = with_contacts ? &contact_adjoints_ : nullptr,
                  .by_radius = if_any(g.particle_radius)});
  if (!any(g.shape_margin, g.shape_material_ke, g.shape_material_kd, g.shape_material_mu)) return;
  if (with_contacts) {
    const auto contacts = static_cast<int64_t>(in.contacts->soft_contact_max());
    novaphy::run(kernels().contact_shape, contacts,
                 {.begin = step_.contact_begin(),
                  .items = step_.contact_items(),
                  .particles = m.particle_count(),
                  .shape = in.contacts->soft_contact_shape,
                  .shape_of_contact = shape_of_contact_});
    novaphy::run(incidence(), m.shape_count(),
                 {.table = shape_of_contact_,
                  .slots = contacts,
                  .offsets = shape_begin_,
                  .items = of_shapes_});
  }
  novaphy::run(kernels().shape_gradient, m.shape_count(),
               {.begin = with_contacts ? &shape_begin_ : nullptr,
                .contacts = with_contacts ? &of_shapes_ : nullptr,
                .contact_adjoints = with_contacts ? &contact_adjoints_ : nullptr,
                .mu = m.shape_material_mu,
                .model_mu = m.soft_contact_mu,
                .h = step_.dt(),
                .by_margin = if_any(g.shape_margin),
                .by_ke = if_any(g.shape_material_ke),
                .by_kd = if_any(g.shape_material_kd),
                .by_mu = if_any(g.shape_material_mu)});
}

}  // namespace novaphy::vbd
