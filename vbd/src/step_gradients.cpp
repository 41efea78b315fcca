// From the bars of slots, contacts and targets to the derivatives by the arrays of the model and
// the state.
#include "novaphy/core/builtin_kernels.h"
#include "step_adjoint.h"

namespace novaphy::detail {
const char* vbd_gradient_kernels_text();
}  // namespace novaphy::detail

namespace novaphy::vbd {
namespace {

// Never destroyed: recordings refer to them.
struct GradientKernels {
#define NOVAPHY_VBD_KERNEL(name) \
  Kernel<decltype(vbd_##name)::Arguments> name{vbd_##name, detail::vbd_gradient_kernels_text};
  NOVAPHY_VBD_KERNEL(particle_gradient)
  NOVAPHY_VBD_KERNEL(target_gradient)
  NOVAPHY_VBD_KERNEL(gravity_gradient)
  NOVAPHY_VBD_KERNEL(spring_gradient)
  NOVAPHY_VBD_KERNEL(edge_gradient)
  NOVAPHY_VBD_KERNEL(triangle_gradient)
  NOVAPHY_VBD_KERNEL(tetrahedron_gradient)
  NOVAPHY_VBD_KERNEL(radius_gradient)
  NOVAPHY_VBD_KERNEL(contact_shape)
  NOVAPHY_VBD_KERNEL(shape_gradient)
#undef NOVAPHY_VBD_KERNEL
};
const GradientKernels& kernels() {
  static const auto& all = *new GradientKernels;
  return all;
}

template <class... D>
bool any(const D&... derivatives) {
  return (derivatives.is_wanted() || ...);
}

}  // namespace

void StepAdjoint::put(const StepInputs& in, const StepDerivatives& g) const {
  put_state(in, g);
  put_elements(g);
  put_contacts(in, g);
}

void StepAdjoint::put_state(const StepInputs& in, const StepDerivatives& g) const {
  const Model& m = step_.model();
  const bool guessed = !key_.at_rest && step_.looks_back(in);
  if (any(g.particle_q, g.particle_qd, g.particle_f, g.particle_mass, g.gravity, g.last_velocity))
    novaphy::run(kernels().particle_gradient, m.particle_count(),
                 {.is_held = step_.is_held(),
                  .inv_mass = m.particle_inv_mass,
                  .f = in.f,
                  .x_bar = x_bar_,
                  .start_bar = start_bar_,
                  .target_bar = target_bar_,
                  .mass_bar = mass_bar_,
                  .h = step_.dt(),
                  .have_targets = int{in.targets.word() != 0},
                  .by_q = g.particle_q,
                  .by_qd = g.particle_qd,
                  .by_f = g.particle_f,
                  .by_mass = g.particle_mass,
                  .by_gravity = any(g.gravity) ? &gravity_bar_ : nullptr,
                  .by_last = g.last_velocity,
                  .last = guessed ? Optional<ReadsRow<VbdRow>>(in.last_velocity)
                                  : Optional<ReadsRow<VbdRow>>(nullptr),
                  .qd = in.qd,
                  .world = m.particle_world,
                  .gravity = m.gravity,
                  .last_world = m.world_count() - 1});
  if (any(g.targets))
    novaphy::run(kernels().target_gradient, step_.kinematic_count(),
                 {.held = step_.held(),
                  .x_bar = x_bar_,
                  .has_targets = int{in.targets.word() != 0},
                  .by_targets = g.targets});
  if (any(g.gravity))
    novaphy::run(kernels().gravity_gradient, m.world_count(),
                 {.begin = tables_.world_begin,
                  .particles = tables_.of_worlds,
                  .of_particles = gravity_bar_,
                  .by_gravity = g.gravity});
}

VbdLawArguments StepAdjoint::law_bars(Role role) const {
  return {.places = tables_.places[role],
          .numbers = numbers_,
          .first = tables_.numbers_begin[role],
          .lanes = step_.slots().lanes()};
}

void StepAdjoint::put_elements(const StepDerivatives& g) const {
  const Model& m = step_.model();
  const float h = step_.dt();
  const auto rows = [](const Array& elements) { return static_cast<int64_t>(elements.rows()); };
  if (any(g.particle_spring_stiffness, g.particle_spring_damping, g.particle_spring_rest_length))
    novaphy::run(kernels().spring_gradient, rows(m.particle_spring_indices),
                 {.bars = law_bars(kSpring),
                  .h = h,
                  .by_stiffness = g.particle_spring_stiffness,
                  .by_damping = g.particle_spring_damping,
                  .by_rest_length = g.particle_spring_rest_length});
  if (any(g.particle_tri_material, g.particle_tri_activation, g.particle_tri_area,
          g.particle_tri_pose))
    novaphy::run(kernels().triangle_gradient, rows(m.particle_tri_indices),
                 {.bars = law_bars(kTriangle),
                  .area = m.particle_tri_area,
                  .material = m.particle_tri_material,
                  .h = h,
                  .by_material = g.particle_tri_material,
                  .by_activation = g.particle_tri_activation,
                  .by_area = g.particle_tri_area,
                  .by_pose = g.particle_tri_pose});
  if (any(g.particle_edge_material, g.particle_edge_rest_angle, g.particle_edge_rest_length))
    novaphy::run(kernels().edge_gradient, rows(m.particle_edge_indices),
                 {.opposite = law_bars(kHingeOpposite),
                  .end = law_bars(kHingeEnd),
                  .material = m.particle_edge_material,
                  .rest_length = m.particle_edge_rest_length,
                  .h = h,
                  .by_material = g.particle_edge_material,
                  .by_rest_angle = g.particle_edge_rest_angle,
                  .by_rest_length = g.particle_edge_rest_length});
  if (any(g.particle_tet_material, g.particle_tet_activation, g.particle_tet_pose))
    novaphy::run(kernels().tetrahedron_gradient, rows(m.particle_tet_indices),
                 {.bars = law_bars(kTetrahedron),
                  .pose = m.particle_tet_pose,
                  .material = m.particle_tet_material,
                  .h = h,
                  .by_material = g.particle_tet_material,
                  .by_activation = g.particle_tet_activation,
                  .by_pose = g.particle_tet_pose});
}

void StepAdjoint::put_contacts(const StepInputs& in, const StepDerivatives& g) const {
  const Model& m = step_.model();
  const bool with_contacts = key_.with_contacts;
  if (any(g.particle_radius))
    novaphy::run(kernels().radius_gradient, m.particle_count(),
                 {.contact_begin = with_contacts ? &step_.contact_begin() : nullptr,
                  .contact_bars = with_contacts ? &contact_bars_ : nullptr,
                  .by_radius = g.particle_radius});
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
                .contact_bars = with_contacts ? &contact_bars_ : nullptr,
                .mu = m.shape_material_mu,
                .model_mu = m.soft_contact_mu,
                .h = step_.dt(),
                .by_margin = g.shape_margin,
                .by_ke = g.shape_material_ke,
                .by_kd = g.shape_material_kd,
                .by_mu = g.shape_material_mu});
}

}  // namespace novaphy::vbd
