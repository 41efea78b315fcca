// SolverVBD.
#include "exchange.h"
#include "fast_step.h"
#include "novaphy/vbd/solver_vbd.h"
#ifdef NOVAPHY_PYTHON_DIFF
#include "novaphy/vbd/diff_vbd.h"
#endif

namespace novaphy::python {
namespace {

constexpr std::pair<const char*, VbdInitialGuess> kGuesses[] = {
    {"inertia", VbdInitialGuess::Inertia},
    {"previous", VbdInitialGuess::Previous},
    {"adaptive", VbdInitialGuess::Adaptive}};

VbdInitialGuess to_guess(const std::string& name) {
  for (const auto& [known, guess] : kGuesses)
    if (name == known) return guess;
  fail(ErrorKind::Value,
       "initial_guess: expected \"inertia\", \"previous\" or \"adaptive\", got \"", name, "\"");
}

DeviceArray<Vec3f> to_targets(py::handle given, Device device) {
  if (py::isinstance<Array>(given)) return DeviceArray<Vec3f>(given.cast<Array>());
  return DeviceArray<Vec3f>::from_host(to_vec3_list(given, "targets"), device);
}

#ifdef NOVAPHY_PYTHON_DIFF
void bind_diff_vbd(py::module_& solvers) {
  using diff::DiffSolverVBD, diff::DiffVbdOptions, diff::VbdGradientInfo;
  py::class_<VbdGradientInfo>(solvers, "VbdGradientInfo", "What gradients of DiffSolverVBD are.")
      .def_readonly("label", &VbdGradientInfo::label,
                    "\"exact\": the derivative of the sweeps that ran.")
      .def_readonly("primal", &VbdGradientInfo::primal,
                    "VbdResidual of the step that the last backward ran.");
  const DiffVbdOptions d;
  py::class_<DiffSolverVBD, SolverBase> solver(
      solvers, "DiffSolverVBD",
      "SolverVBD with the derivative of its iteration: a step or rollout on an active tape is "
      "recorded, and backward goes back through every colour of every iteration. Gradients of "
      "positions, velocities, forces, materials, rest lengths of springs, rest angles of edges and "
      "activations are exact for the sweeps that ran; contacts are frozen. Other arrays of the "
      "model that carry a gradient raise NotImplementedError by name.");
  solver
      .def(py::init([](const std::shared_ptr<Model>& model, int32_t iterations,
                       float friction_epsilon, const std::string& initial_guess,
                       float lhs_regularization, const std::string& gradient) {
             require(gradient == "unrolled" || gradient == "implicit", ErrorKind::Value,
                     "DiffSolverVBD: gradient: expected \"unrolled\" or \"implicit\", got \"",
                     gradient, "\"");
             require(gradient == "unrolled", ErrorKind::NotImplemented,
                     "DiffSolverVBD: gradient \"implicit\" is not there yet; use \"unrolled\"");
             return std::make_unique<DiffSolverVBD>(
                 model, DiffVbdOptions{.iterations = iterations,
                                       .friction_epsilon = friction_epsilon,
                                       .initial_guess = to_guess(initial_guess),
                                       .lhs_regularization = lhs_regularization});
           }),
           py::arg("model").none(false), py::kw_only(), "iterations"_a = d.iterations,
           "friction_epsilon"_a = d.friction_epsilon, "initial_guess"_a = "inertia",
           "lhs_regularization"_a = d.lhs_regularization, "gradient"_a = "unrolled",
           "Options as SolverVBD's, without those that have no gradient. gradient: \"unrolled\". "
           "ValueError and NotImplementedError as SolverVBD.")
      .def_property_readonly(
          "iterations", [](const DiffSolverVBD& s) { return s.options().iterations; },
          "Sweeps over all colours in a step.")
      .def("gradient_info", &DiffSolverVBD::gradient_info,
           "VbdGradientInfo of the last backward. novaphy.Error: there was none.");
  add_fast_step(solver);
}
#endif

}  // namespace

void bind_vbd(py::module_& solvers) {
  py::class_<VbdResidual>(solvers, "VbdResidual", "How far a step of SolverVBD was from its end.")
      .def_readonly("force", &VbdResidual::force,
                    "N: norm of the force on all particles that move, inertia included.")
      .def_readonly("scale", &VbdResidual::scale,
                    "N: norm of m (y - xn)/h^2, what the step has to balance.")
      .def_readonly("relative", &VbdResidual::relative, "force / scale; 0 where the force is 0.")
      .def_readonly("floor", &VbdResidual::floor,
                    "Of relative: what one rounding of the positions changes.")
      .def_readonly("iterations", &VbdResidual::iterations, "Iterations that ran.");

  const VbdOptions d;
  py::class_<SolverVBD, SolverBase>(
      solvers, "SolverVBD",
      "Implicit Euler by Vertex Block Descent: stable at large steps and stiffnesses. Covers "
      "particles, springs, triangles, bending edges, tetrahedra, external forces, gravity, and "
      "contacts with world-owned shapes. Particles need colours: ModelBuilder.color(). Particles "
      "of mass 0 or without ParticleFlags.ACTIVE are held. Nothing is written to state_in. Same "
      "bits for any number of threads. Raises on a tape.")
      .def(
          py::init([](const std::shared_ptr<Model>& model, int32_t iterations,
                      float friction_epsilon, const std::string& initial_guess,
                      std::optional<float> acceleration, std::optional<float> tolerance,
                      bool safeguard, float lhs_regularization) {
            return std::make_unique<SolverVBD>(
                model, VbdOptions{.iterations = iterations,
                                  .friction_epsilon = friction_epsilon,
                                  .initial_guess = to_guess(initial_guess),
                                  .acceleration = acceleration,
                                  .tolerance = tolerance,
                                  .safeguard = safeguard,
                                  .lhs_regularization = lhs_regularization});
          }),
          py::arg("model").none(false), py::kw_only(), "iterations"_a = d.iterations,
          "friction_epsilon"_a = d.friction_epsilon, "initial_guess"_a = "inertia",
          "acceleration"_a = py::none(), "tolerance"_a = py::none(), "safeguard"_a = d.safeguard,
          "lhs_regularization"_a = d.lhs_regularization,
          "iterations: sweeps over all colours. friction_epsilon (m/s): the slip at which friction "
          "reaches the Coulomb limit. initial_guess: \"inertia\", \"previous\" (the positions "
          "before) or \"adaptive\" (with as much of gravity as acted in the last step). "
          "acceleration: Chebyshev's, by a spectral radius in (0, 1). tolerance: ends a step when "
          "residual().relative is at most this. safeguard: halves the step of a particle while "
          "its energy rises. ValueError: a bad option, particles without a colour, a negative or "
          "NaN material. NotImplementedError names what is not covered.")
      .def_property_readonly(
          "iterations", [](const SolverVBD& s) { return s.options().iterations; },
          "Sweeps over all colours in a step.")
      .def_property_readonly(
          "friction_epsilon", [](const SolverVBD& s) { return s.options().friction_epsilon; },
          "m/s")
      .def_property_readonly(
          "initial_guess",
          [](const SolverVBD& s) {
            return kGuesses[static_cast<size_t>(s.options().initial_guess)].first;
          },
          "\"inertia\", \"previous\" or \"adaptive\".")
      .def_property_readonly(
          "acceleration", [](const SolverVBD& s) { return s.options().acceleration; },
          "The spectral radius, or None.")
      .def_property_readonly(
          "tolerance", [](const SolverVBD& s) { return s.options().tolerance; },
          "Of residual().relative, or None.")
      .def_property_readonly(
          "safeguard", [](const SolverVBD& s) { return s.options().safeguard; },
          "Whether steps are halved while the energy rises.")
      .def_property_readonly(
          "lhs_regularization", [](const SolverVBD& s) { return s.options().lhs_regularization; },
          "Of blocks that are nearly singular.")
      .def_property_readonly("held_count", &SolverVBD::held_count,
                             "Particles that are held: the rows of targets.")
      .def(
          "step",
          [](SolverVBD& s, SimState& state_in, SimState& state_out, const Control* control,
             const Contacts* contacts, float dt, py::handle targets) {
            DeviceArray<Vec3f> to;
            if (!targets.is_none()) to = to_targets(targets, s.device());
            const ReleasedGil release;
            s.step(state_in, state_out, control, contacts, dt, targets.is_none() ? nullptr : &to);
          },
          "state_in"_a, "state_out"_a, "control"_a.none(true), "contacts"_a.none(true), "dt"_a,
          py::kw_only(), "targets"_a = py::none(),
          "Advances state_in by dt (s) into state_out. targets: {held_count, 3} positions (m, "
          "world frame) where the held particles are at the end, in the order of their indices; "
          "None: where they are. Errors as SolverBase.step; ValueError: indices or colours that "
          "were edited after the solver was made; novaphy.Error: contacts that overflowed.")
      .def("residual", &SolverVBD::residual, release_gil(),
           "VbdResidual of the last step. novaphy.Error: there was none.")
      .def("reset", &SolverVBD::reset,
           "Forgets the last step, which the adaptive guess and residual() look at.");
#ifdef NOVAPHY_PYTHON_DIFF
  bind_diff_vbd(solvers);
#endif
}

}  // namespace novaphy::python
