// Views, differentiable operators, losses, Trajectory and the differentiable solver.
#include "fast_step.h"
#include "nova_types.h"
#include "novaphy/collision/diff_soft_contacts.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/diff/engine_kernels.h"
#include "novaphy/diff/losses.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/diff/trajectory.h"
#include "novaphy/dynamics/semi_implicit/diff_particles.h"

namespace novaphy::python {

using nova::Tensor;

namespace {

using diff::DiffSemiImplicitSolver;
using diff::DiffSolverConfig;
using diff::Trajectory;

#define NOVAPHY_BIND_STATE_VIEW(field)                                                      \
  m.def("state_" #field "_tensor", &diff::state_##field##_tensor, "state"_a,                \
        "requires_grad"_a = false,                                                          \
        "The state's " #field                                                               \
        " as a Tensor: the same memory, the same Tensor at every call. requires_grad=True " \
        "turns the gradient on; False leaves it as it is.");
#define NOVAPHY_BIND_MODEL_VIEW(field)                                                      \
  m.def("model_" #field "_tensor", &diff::model_##field##_tensor, "model"_a,                \
        "requires_grad"_a = false,                                                          \
        "The model's " #field                                                               \
        " as a Tensor: the same memory, the same Tensor at every call. requires_grad=True " \
        "turns the gradient on; False leaves it as it is.");

void bind_views(py::module_& m) {
  NOVAPHY_STATE_VIEWS(NOVAPHY_BIND_STATE_VIEW)
  NOVAPHY_MODEL_VIEWS(NOVAPHY_BIND_MODEL_VIEW)
  m.def("update_inverse_mass", &diff::update_inverse_mass, "model"_a, release_gil(),
        "particle_inv_mass = 1 / particle_mass, 0 where the mass is 0. Not recorded.");
}

void bind_operators(py::module_& m) {
  m.def(
      "eval_static_particle_shape_contact_forces_generated",
      &diff::eval_static_particle_shape_contact_forces_generated, "model"_a, "particle_q"_a,
      "particle_qd"_a, "particle_f"_a, "soft_contact_margin"_a = 0.0f, release_gil(),
      "particle_f {n, 3} plus the forces (N) of all world-owned planes, boxes, spheres and "
      "capsules at the true distance. "
      "Exact gradients for positions, velocities, forces, radii and materials; shapes carry none.");
  m.def("integrate_particles_generated", &diff::integrate_particles_generated, "model"_a,
        "particle_q"_a, "particle_qd"_a, "particle_f"_a, "dt"_a, release_gil(),
        "Symplectic Euler: (positions {n, 3} m, velocities {n, 3} m/s) after dt (s). Exact "
        "gradients, also for gravity and "
        "masses.");
  m.def("integrate_particles_with_static_contacts_generated",
        &diff::integrate_particles_with_static_contacts_generated, "model"_a, "particle_q"_a,
        "particle_qd"_a, "particle_f"_a, "soft_contact_margin"_a, "dt"_a, release_gil(),
        "Forces of static shapes and integration in one kernel, with the bits of one after the "
        "other: (q, qd).");
  m.def("particle_point_loss_generated", &diff::particle_point_loss_generated, "particle_q"_a,
        "particle_index"_a, "target_x"_a, "target_y"_a, "target_z"_a, release_gil(),
        "|q[particle_index] - target|^2, {1}, m^2. IndexError: no such particle.");
  m.def("particle_centroid_generated", &diff::particle_centroid_generated, "particle_q"_a,
        release_gil(), "Mean position {1, 3}, m, not weighted by mass.");
  m.def("vec3_point_loss_generated", &diff::vec3_point_loss_generated, "point"_a, "target_x"_a,
        "target_y"_a, "target_z"_a, release_gil(),
        "|point - target|^2, {1}, m^2, of a point {1, 3} or {3}.");
  m.def("clamp_f32_generated", &diff::clamp_f32_generated, "x"_a, "lower"_a, "upper"_a,
        release_gil(),
        "x limited to [lower, upper]; gradient 1 inside and at the bounds, 0 outside.");
}

// {steps + 1, n, 3}: the whole of a field as one tensor.
Tensor whole(const Trajectory& t, const DeviceArray<Vec3f>& array) {
  return {array.range(), {t.steps() + 1, t.model()->particle_count(), 3}, nova::DType::F32};
}

void bind_trajectory(py::module_& m) {
  py::class_<Trajectory>(m, "Trajectory",
                         "steps + 1 states of a model, contiguous in time: len() states, [t] is a "
                         "regular SimState. State 0 "
                         "starts with the model's initial values.")
      .def(py::init([](const std::shared_ptr<Model>& model, int32_t steps, bool requires_grad) {
             return std::make_unique<Trajectory>(model, steps, requires_grad);
           }),
           py::arg("model").none(false), "steps"_a, "requires_grad"_a = true,
           "ValueError unless steps >= 0.")
      .def("__len__", [](const Trajectory& t) { return t.steps() + 1; })
      .def("__iter__",
           [](const py::object& self) {
             py::list states;
             const int32_t count = self.cast<Trajectory&>().steps() + 1;
             for (int32_t t = 0; t < count; ++t) states.append(self[py::int_(t)]);
             return py::iter(states);
           })
      .def(
          "__getitem__",
          [](Trajectory& t, int32_t k) -> SimState& {
            return t.state(k < 0 ? k + t.steps() + 1 : k);
          },
          "t"_a, py::return_value_policy::reference_internal, "State t. IndexError.")
      .def_property_readonly("steps", &Trajectory::steps, "Steps: one less than states.")
      .def_property_readonly(
          "model", [](const Trajectory& t) { return std::const_pointer_cast<Model>(t.model()); },
          "The model.")
      .def_property_readonly(
          "particle_q", [](const Trajectory& t) { return whole(t, t.particle_q()); },
          "Tensor {steps + 1, n, 3}, m, world frame.")
      .def_property_readonly(
          "particle_qd", [](const Trajectory& t) { return whole(t, t.particle_qd()); },
          "Tensor {steps + 1, n, 3}, m/s, world frame.")
      .def_property_readonly(
          "particle_f", [](const Trajectory& t) { return Tensor::view(t.particle_f()); },
          "Tensor {n, 3}, N, world frame: the force that is applied in every step; all states "
          "share it.");
}

void bind_solver(py::module_& solvers) {
  const DiffSolverConfig d;
  py::class_<DiffSolverConfig> config(solvers, "DiffSolverConfig",
                                      "What a DiffSemiImplicitSolver covers.");
  config.def(
      py::init([](bool enable_particles, bool enable_particle_contacts, bool enable_tetrahedra,
                  bool enable_triangles, bool enable_rigid, bool enable_rigid_contacts,
                  float angular_damping, float friction_smoothing, bool strict) {
        return DiffSolverConfig{.enable_particles = enable_particles,
                                .enable_particle_contacts = enable_particle_contacts,
                                .enable_tetrahedra = enable_tetrahedra,
                                .enable_triangles = enable_triangles,
                                .enable_rigid = enable_rigid,
                                .enable_rigid_contacts = enable_rigid_contacts,
                                .angular_damping = angular_damping,
                                .friction_smoothing = friction_smoothing,
                                .strict = strict};
      }),
      py::kw_only(), "enable_particles"_a = d.enable_particles,
      "enable_particle_contacts"_a = d.enable_particle_contacts,
      "enable_tetrahedra"_a = d.enable_tetrahedra, "enable_triangles"_a = d.enable_triangles,
      "enable_rigid"_a = d.enable_rigid, "enable_rigid_contacts"_a = d.enable_rigid_contacts,
      "angular_damping"_a = d.angular_damping, "friction_smoothing"_a = d.friction_smoothing,
      "strict"_a = d.strict);
#define NOVAPHY_MEMBER(name, doc) config.def_readwrite(#name, &DiffSolverConfig::name, doc);
  NOVAPHY_MEMBER(enable_particles, "Particles move.")
  NOVAPHY_MEMBER(enable_particle_contacts, "Contacts of particles act.")
  NOVAPHY_MEMBER(enable_tetrahedra, "Not built yet: NotImplementedError.")
  NOVAPHY_MEMBER(enable_triangles, "Not built yet: NotImplementedError.")
  NOVAPHY_MEMBER(enable_rigid, "Acts on bodies, which no model has yet.")
  NOVAPHY_MEMBER(enable_rigid_contacts, "Acts on bodies, which no model has yet.")
  NOVAPHY_MEMBER(angular_damping, "1/s")
  NOVAPHY_MEMBER(friction_smoothing, "m/s")
  NOVAPHY_MEMBER(strict, "Refuse what is not covered instead of leaving it out.")
#undef NOVAPHY_MEMBER

  py::class_<DiffSemiImplicitSolver, SolverBase> solver(
      solvers, "DiffSemiImplicitSolver",
      "The semi-implicit step as generated kernels (contact forces, then integration), with the "
      "bits of SolverSemiImplicit. "
      "On an active tape both are recorded on the states' own arrays. Gradients: positions, "
      "velocities, forces, masses, "
      "radii, gravity and contact materials are exact; contact points and normals are frozen. "
      "Forces left in "
      "state_in.particle_f are for reading: clear_forces() before the state is used again.");
  solver
      .def(py::init([](const std::shared_ptr<Model>& model, const DiffSolverConfig* given) {
             return std::make_unique<DiffSemiImplicitSolver>(
                 model, given != nullptr ? *given : DiffSolverConfig{});
           }),
           py::arg("model").none(false), "config"_a = py::none(),
           "NotImplementedError for what is not covered.")
      .def_property_readonly(
          "config", [](const DiffSemiImplicitSolver& s) { return s.config(); },
          "A copy of the settings.")
      .def("rollout", &DiffSemiImplicitSolver::rollout, "trajectory"_a, "control"_a.none(true),
           "contacts"_a.none(true), "dt"_a, release_gil(),
           "All steps of a trajectory from its state 0, contacts and integration in one kernel per "
           "step, recorded on an "
           "active tape. The bits of a loop of step in which every step starts from the force in "
           "trajectory.particle_f, "
           "which is only read. May be captured.");
  add_fast_step(solver);
}

void bind_engine_programs(py::module_& m) {
  m.def(
      "engine_programs",
      [] {
        std::vector<nova::EngineKernel> kernels = nova::engine_kernels();
        for (nova::EngineKernel& k : diff::engine_kernels()) kernels.push_back(std::move(k));
        std::map<uint64_t, std::string> texts;
        for (const nova::ir::Program& p : nova::programs_of(kernels))
          texts[nova::ir::hash(p)] = nova::ir::to_string(p);
        return texts;
      },
      release_gil(),
      "The Programs of the engine's own kernels and of their adjoints that are built ahead: hash, "
      "as in KernelInfo, to text.");
}

}  // namespace

void bind_diff(py::module_& m, py::module_& solvers) {
  bind_engine_programs(m);
  bind_views(m);
  bind_operators(m);
  bind_trajectory(m);
  bind_solver(solvers);
}

}  // namespace novaphy::python
