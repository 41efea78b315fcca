// Bindings of SolverFeatherstone and of the dynamics of articulations (eval_mass_matrix, ...).
#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include "contact_options.h"
#include "doc_featherstone.h"
#include "fast_step.h"
#include "novaphy/dynamics/featherstone/articulation_functions.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"
#include "part_bindings.h"

namespace novaphy::python {
namespace {

// Returns the memory of a vector as an array, without a copy.
py::array_t<float> to_array(std::vector<float>&& values, std::vector<py::ssize_t> shape) {
  auto* owned = new std::vector<float>(std::move(values));
  const py::capsule owner(owned, [](void* p) { delete static_cast<std::vector<float>*>(p); });
  return py::array_t<float>(std::move(shape), owned->data(), owner);
}
py::array_t<float> to_array(std::vector<float>&& values) {
  const auto size = static_cast<py::ssize_t>(values.size());
  return to_array(std::move(values), {size});
}
py::array_t<float> to_array(ArticulationMatrices&& m) {
  return to_array(std::move(m.values), {m.count, m.rows, m.columns});
}
template <class Vec>
py::array_t<float> to_rows(const std::vector<Vec>& rows) {
  constexpr auto width = static_cast<py::ssize_t>(sizeof(Vec) / sizeof(float));
  const auto* numbers = reinterpret_cast<const float*>(rows.data());
  const auto count = static_cast<py::ssize_t>(rows.size());
  return to_array(std::vector<float>(numbers, numbers + count * width), {count, width});
}

std::vector<float> to_dofs(const Model& model, py::handle value, const char* name) {
  std::vector<float> numbers(static_cast<size_t>(model.joint_dof_count()));
  to_floats(value, name, numbers);
  return numbers;
}
template <class F>
auto unlocked(F&& f) {
  const ReleasedGil released;
  return f();
}

void bind_actuator_forces(py::module_& m) {
  m.def(
      "eval_actuator_forces",
      [](const Model& model, const SimState& state, const Control* control) {
        return to_array(unlocked([&] { return eval_actuator_forces(model, state, control); }));
      },
      "model"_a, "state"_a, "control"_a = py::none(),
      "Returns the force of each actuator {actuators} at a state, before the multiplication by "
      "gear. control: None: the control of the model. ValueError: the state or the control belongs "
      "to another model.");
}

void bind_functions(py::module_& m) {
  bind_actuator_forces(m);
  m.def(
      "eval_inverse_dynamics",
      [](const Model& model, const SimState& state, py::handle qdd) {
        const std::vector<float> a = to_dofs(model, qdd, "qdd");
        return to_array(unlocked([&] { return eval_inverse_dynamics(model, state, a); }));
      },
      "model"_a, "state"_a, "qdd"_a, doc::kInverseDynamics);
  m.def(
      "eval_bias",
      [](const Model& model, const SimState& state) {
        return to_array(unlocked([&] { return eval_bias(model, state); }));
      },
      "model"_a, "state"_a,
      "Returns the generalized bias forces {dofs} (N, N*m) of gravity and velocities, which are "
      "eval_inverse_dynamics for qdd = 0. Mimic joints count as free joints.");
  m.def(
      "eval_forward_dynamics",
      [](const Model& model, const SimState& state, py::handle tau) {
        const std::vector<float> t = to_dofs(model, tau, "tau");
        return to_array(unlocked([&] { return eval_forward_dynamics(model, state, t); }));
      },
      "model"_a, "state"_a, "tau"_a,
      "Returns the joint accelerations {dofs} (m/s^2, rad/s^2) that the generalized forces tau "
      "{dofs} (N, N*m) cause. novaphy.Error: the mass matrix is singular; the message names the "
      "dof.");
  m.def(
      "eval_mass_matrix",
      [](const Model& model, const SimState& state, bool include_armature) {
        return to_array(unlocked([&] { return eval_mass_matrix(model, state, include_armature); }));
      },
      "model"_a, "state"_a, "include_armature"_a = true, doc::kMassMatrix);
  m.def(
      "eval_jacobian",
      [](const Model& model, const SimState& state) {
        return to_array(unlocked([&] { return eval_jacobian(model, state); }));
      },
      "model"_a, "state"_a,
      "Returns the Jacobians {articulations, 6 L, D} of the bodies' velocities by the joint rates, "
      "padded with 0. A joint has six rows: body_qd of its child (linear, angular). L is the "
      "largest number of joints of an articulation, and D the largest number of dofs.");
  m.def(
      "eval_inverse_dynamics_derivatives",
      [](const Model& model, const SimState& state, py::handle qdd) {
        const std::vector<float> a = to_dofs(model, qdd, "qdd");
        auto d = unlocked([&] { return eval_inverse_dynamics_derivatives(model, state, a); });
        return py::make_tuple(to_array(std::move(d.dtau_dq)), to_array(std::move(d.dtau_dqd)),
                              to_array(std::move(d.mass_matrix)));
      },
      "model"_a, "state"_a, "qdd"_a, doc::kInverseDerivatives);
  m.def(
      "eval_forward_dynamics_derivatives",
      [](const Model& model, const SimState& state, py::handle tau) {
        const std::vector<float> t = to_dofs(model, tau, "tau");
        auto d = unlocked([&] { return eval_forward_dynamics_derivatives(model, state, t); });
        return py::make_tuple(to_array(std::move(d.dqdd_dq)), to_array(std::move(d.dqdd_dqd)),
                              to_array(std::move(d.inverse_mass_matrix)));
      },
      "model"_a, "state"_a, "tau"_a, doc::kForwardDerivatives);
  m.def(
      "eval_center_of_mass",
      [](const Model& model, const SimState& state) {
        return to_rows(unlocked([&] { return eval_center_of_mass(model, state); }));
      },
      "model"_a, "state"_a,
      "Returns the center of mass of each articulation {articulations, 3} (m, world frame).");
  m.def(
      "eval_energy",
      [](const Model& model, const SimState& state) {
        return to_rows(unlocked([&] { return eval_energy(model, state); }));
      },
      "model"_a, "state"_a,
      "Returns the kinetic and the potential energy of each articulation {articulations, 2} (J). "
      "The kinetic energy leaves out the armature.");
}

std::unique_ptr<SolverFeatherstone> make_solver(
    const std::shared_ptr<Model>& model, float angular_damping, bool implicit_drives,
    const std::optional<std::string>& contact, const std::string& friction_cone, int pgs_iterations,
    float pgs_tolerance, float pgs_erp, float pgs_slop, float pgs_cfm,
    float max_depenetration_velocity, float restitution_threshold, bool warm_start,
    bool compliant_contacts, float friction_smoothing, const std::optional<SleepConfig>& sleep,
    const std::string& joint_limits, float joint_limit_restitution) {
  return std::make_unique<SolverFeatherstone>(
      model, FeatherstoneOptions{.angular_damping = angular_damping,
                                 .implicit_drives = implicit_drives,
                                 .joint_limits = to_limits("SolverFeatherstone", joint_limits),
                                 .joint_limit_restitution = joint_limit_restitution,
                                 .contact = to_contact(contact),
                                 .friction_cone = to_cone(friction_cone),
                                 .pgs_iterations = pgs_iterations,
                                 .pgs_tolerance = pgs_tolerance,
                                 .pgs_erp = pgs_erp,
                                 .pgs_slop = pgs_slop,
                                 .pgs_cfm = pgs_cfm,
                                 .max_depenetration_velocity = max_depenetration_velocity,
                                 .restitution_threshold = restitution_threshold,
                                 .warm_start = warm_start,
                                 .compliant_contacts = compliant_contacts,
                                 .friction_smoothing = friction_smoothing,
                                 .sleep = sleep});
}

}  // namespace

void bind_featherstone(py::module_& m, py::module_& solvers) {
  bind_functions(m);
  const FeatherstoneOptions d;
  py::class_<SolverFeatherstone, SolverBase> solver(solvers, "SolverFeatherstone",
                                                    doc::kFeatherstone);
  solver
      .def(py::init(&make_solver), py::arg("model").none(false), py::kw_only(),
           "angular_damping"_a = d.angular_damping, "implicit_drives"_a = d.implicit_drives,
           "contact"_a = "pgs", "friction_cone"_a = "cone", "pgs_iterations"_a = d.pgs_iterations,
           "pgs_tolerance"_a = d.pgs_tolerance, "pgs_erp"_a = d.pgs_erp, "pgs_slop"_a = d.pgs_slop,
           "pgs_cfm"_a = d.pgs_cfm, "max_depenetration_velocity"_a = d.max_depenetration_velocity,
           "restitution_threshold"_a = d.restitution_threshold, "warm_start"_a = d.warm_start,
           "compliant_contacts"_a = d.compliant_contacts,
           "friction_smoothing"_a = d.friction_smoothing, "sleep"_a = py::none(),
           "joint_limits"_a = "spring", "joint_limit_restitution"_a = d.joint_limit_restitution,
           doc::kFeatherstoneInit)
      .def_property_readonly(
          "sleep", [](const SolverFeatherstone& s) { return s.options().sleep; },
          "The SleepConfig for bodies on FREE joints; None: no body sleeps.")
      .def_property_readonly(
          "contact", [](const SolverFeatherstone& s) { return contact_name(s.options().contact); },
          "The contact law: \"pgs\", \"penalty\" or None.")
      .def_property_readonly(
          "joint_limits",
          [](const SolverFeatherstone& s) { return limits_name(s.options().joint_limits); },
          "The kind of joint limits: \"spring\" or \"row\" (impulses).")
      .def_property_readonly(
          "joint_limit_restitution",
          [](const SolverFeatherstone& s) { return s.options().joint_limit_restitution; },
          "The restitution of joint limits, 0 to 1, with joint_limits=\"row\".")
      .def_property_readonly(
          "friction_cone",
          [](const SolverFeatherstone& s) {
            return kCones[static_cast<size_t>(s.options().friction_cone)];
          },
          "The friction cone: \"cone\" or \"pyramid\".")
      .def("check_last_step", &SolverFeatherstone::check_last_step,
           py::call_guard<py::gil_scoped_release>(), doc::kCheckLastStep)
      .def_property_readonly("pgs_sweeps", &SolverFeatherstone::pgs_sweeps,
                             "The largest number of PGS sweeps of an island in the last step.")
      .def_property_readonly("pgs_residual", &SolverFeatherstone::pgs_residual,
                             "The largest velocity change in the final sweep of an island in the "
                             "last step (m/s).")
      .def_property_readonly(
          "angular_damping",
          [](const SolverFeatherstone& s) { return s.options().angular_damping; },
          "The damping of angular dofs (1/s).")
      .def_property_readonly(
          "friction_smoothing",
          [](const SolverFeatherstone& s) { return s.options().friction_smoothing; },
          "The slip below which friction is smooth, with contact=\"penalty\" (m/s).")
      .def_property_readonly(
          "implicit_drives",
          [](const SolverFeatherstone& s) { return s.options().implicit_drives; },
          "Whether drives, limits and damping are evaluated at the end of the step.");
  add_fast_step(solver);
  bind_control_sensitivity(solvers);
}

}  // namespace novaphy::python
