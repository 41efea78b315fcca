// Bindings of SolverVBD and DiffSolverVBD.
#include <pybind11/numpy.h>

#include "doc_vbd.h"
#include "exchange.h"
#include "novaphy/vbd/solver_vbd.h"
#ifdef NOVAPHY_PYTHON_DIFF
#include "gradient_info.h"
#include "nova_types.h"
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

bool to_coarse(const std::optional<std::string>& name) {
  require(!name || *name == "auto", ErrorKind::Value, "coarse: expected \"auto\" or None, got \"",
          name.value_or(""), "\"");
  return name.has_value();
}

bool to_converged(const std::string& solve) {
  require(solve == "iterations" || solve == "converged", ErrorKind::Value,
          "SolverVBD: solve: expected \"iterations\" or \"converged\", got \"", solve, "\"");
  return solve == "converged";
}

// Returns the options of self-contact; empty: no self-contact. `margin` is Newton's name of
// `radius`.
std::optional<VbdSelfContact> to_self_contact(bool enable, std::optional<float> radius,
                                              std::optional<float> margin,
                                              std::optional<float> gap) {
  require(!radius || !margin, ErrorKind::Value,
          "SolverVBD: particle_self_contact_margin: expected None beside "
          "particle_self_contact_radius, which has the same meaning, got ",
          margin.value_or(0.0f));
  const std::pair<const char*, const std::optional<float>&> given[] = {
      {"radius", radius}, {"margin", margin}, {"gap", gap}};
  for (const auto& [name, value] : given)
    require(enable || !value, ErrorKind::Value, "SolverVBD: particle_self_contact_", name,
            ": expected None without particle_enable_self_contact, got ", value.value_or(0.0f));
  if (!enable) return {};
  return VbdSelfContact{.radius = radius ? radius : margin, .gap = gap};
}

template <class T>
py::array_t<T> to_column(const T* values, size_t rows, py::ssize_t width = 0) {
  std::vector<py::ssize_t> shape = {static_cast<py::ssize_t>(rows)};
  if (width != 0) shape.push_back(width);
  py::array_t<T> to(shape);
  std::copy_n(values, to.size(), to.mutable_data());
  return to;
}

constexpr char kKinematicCountDoc[] =
    "The number of kinematic particles, which is the number of rows of targets.";
constexpr char kHeldCountDoc[] = "Deprecated: the old name of kinematic_count.";

template <class Solver>
int32_t old_kinematic_count(const Solver& solver) {
  if (PyErr_WarnEx(PyExc_DeprecationWarning, "held_count is now called kinematic_count", 1) != 0)
    throw py::error_already_set();
  return solver.kinematic_count();
}

DeviceArray<Vec3f> to_targets(py::handle given, Device device) {
  if (py::isinstance<Array>(given)) return DeviceArray<Vec3f>(given.cast<Array>());
  return DeviceArray<Vec3f>::from_host(to_vec3_list(given, "targets"), device);
}

#ifdef NOVAPHY_PYTHON_DIFF
DeviceArray<Vec3f> to_diff_targets(py::handle given, Device device) {
  if (!py::isinstance<nova::TensorImpl>(given)) return to_targets(given, device);
  const auto tensor = given.cast<nova::Tensor>();
  require(tensor.dtype() == nova::DType::F32 && tensor.shape().size() == 2 &&
              tensor.shape().back() == 3,
          ErrorKind::Value, "DiffSolverVBD.step: targets: expected float32 {k, 3}, got ",
          nova::dtype_name(tensor.dtype()), " ", nova::shape_str(tensor.shape()));
  return DeviceArray<Vec3f>(
      Array(DType::vec3, static_cast<size_t>(tensor.size()) / 3, 1, tensor.range()));
}

VbdGradientOptions to_gradient_options(const std::string& gradient,
                                       const std::optional<float>& tolerance,
                                       const std::optional<int32_t>& sweeps,
                                       const std::optional<int32_t>& newton_iterations,
                                       const std::optional<bool>& allow_unconverged) {
  require(gradient == "unrolled" || gradient == "implicit", ErrorKind::Value,
          "DiffSolverVBD: gradient: expected \"unrolled\" or \"implicit\", got \"", gradient, "\"");
  VbdGradientOptions options = {.implicit = gradient == "implicit"};
  const auto set = [&](const char* name, const auto& given, auto& option) {
    if (!given.has_value()) return;
    require(options.implicit, ErrorKind::Value, "DiffSolverVBD: ", name,
            ": expected none with gradient \"unrolled\", where it has no effect");
    option = *given;
  };
  set("gradient_tolerance", tolerance, options.tolerance);
  set("gradient_sweeps", sweeps, options.krylov_sweeps);
  set("newton_iterations", newton_iterations, options.newton_iterations);
  set("allow_unconverged", allow_unconverged, options.allow_unconverged);
  return options;
}

auto to_info(const diff::DiffSolverVBD& s) {
  const diff::DiffVbdGradientInfo i = s.gradient_info();
  return to_fields(i, py::dict("primal"_a = i.primal, "linear_residual"_a = i.linear_residual,
                               "linear_sweeps"_a = i.linear_sweeps, "converged"_a = i.converged,
                               "halvings"_a = i.halvings));
}

void bind_diff_vbd(py::module_& solvers) {
  using diff::DiffSolverVBD, diff::DiffVbdOptions;
  const DiffVbdOptions d;
  py::class_<DiffSolverVBD, SolverBase>(solvers, "DiffSolverVBD", doc::kDiffVbd)
      .def(py::init(
               [](const std::shared_ptr<Model>& model, int32_t iterations, float friction_epsilon,
                  const std::string& initial_guess, const std::optional<std::string>& coarse,
                  float lhs_regularization, const std::string& gradient,
                  std::optional<float> gradient_tolerance, std::optional<int32_t> gradient_sweeps,
                  std::optional<int32_t> newton_iterations, std::optional<bool> allow_unconverged) {
                 return std::make_unique<DiffSolverVBD>(
                     model, DiffVbdOptions{.iterations = iterations,
                                           .friction_epsilon = friction_epsilon,
                                           .initial_guess = to_guess(initial_guess),
                                           .coarse = to_coarse(coarse),
                                           .lhs_regularization = lhs_regularization,
                                           .gradient = to_gradient_options(
                                               gradient, gradient_tolerance, gradient_sweeps,
                                               newton_iterations, allow_unconverged)});
               }),
           py::arg("model").none(false), py::kw_only(), "iterations"_a = d.iterations,
           "friction_epsilon"_a = d.friction_epsilon, "initial_guess"_a = "inertia",
           "coarse"_a = py::none(), "lhs_regularization"_a = d.lhs_regularization,
           "gradient"_a = "unrolled", "gradient_tolerance"_a = py::none(),
           "gradient_sweeps"_a = py::none(), "newton_iterations"_a = py::none(),
           "allow_unconverged"_a = py::none(), doc::kDiffVbdInit)
      .def_property_readonly(
          "iterations", [](const DiffSolverVBD& s) { return s.options().iterations; },
          "The number of sweeps over all colors in a step.")
      .def_property_readonly(
          "gradient",
          [](const DiffSolverVBD& s) {
            return s.options().gradient.implicit ? "implicit" : "unrolled";
          },
          "The kind of gradient: \"unrolled\" or \"implicit\".")
      .def_property_readonly("kinematic_count", &DiffSolverVBD::kinematic_count, kKinematicCountDoc)
      .def_property_readonly("held_count", &old_kinematic_count<DiffSolverVBD>, kHeldCountDoc)
      .def("gradient_info", &to_info, doc::kDiffVbdInfo)
      .def("clear_gradient_info", &DiffSolverVBD::clear_gradient_info,
           "Resets the counts of gradient_info.")
      .def("reset", &DiffSolverVBD::reset, release_gil(),
           "Clears the velocity that initial_guess=\"adaptive\" stores between steps. The call may "
           "be captured.")
      .def(
          "step",
          [](DiffSolverVBD& s, SimState& state_in, SimState& state_out, const Control* control,
             const Contacts* contacts, float dt, py::handle targets) {
            DeviceArray<Vec3f> to;
            if (!targets.is_none()) to = to_diff_targets(targets, s.device());
            const ReleasedGil release;
            s.step(state_in, state_out, control, contacts, dt, targets.is_none() ? nullptr : &to);
          },
          "state_in"_a, "state_out"_a, "control"_a.none(true), "contacts"_a.none(true), "dt"_a,
          py::kw_only(), "targets"_a = py::none(),
          "Advances state_in by dt (s) into state_out, see SolverVBD.step. targets may be a Tensor "
          "that requires a gradient.");
}
#endif

void bind_residual(py::module_& solvers) {
  py::class_<VbdResidual>(
      solvers, "VbdResidual",
      "How far a step of SolverVBD is from its solution, for one connected component of particles. "
      "The component is the one with the largest `relative`, among the components whose `relative` "
      "exceeds twice their `floor`. If there are none, all components are compared.")
      .def_readonly("force", &VbdResidual::force,
                    "The norm of the total force on the particles, with inertia (N).")
      .def_readonly(
          "scale", &VbdResidual::scale,
          "The size of the forces that the step had to balance (N), as a norm over the particles. "
          "These are forces of contacts and elements, gravity, and inertia of the motion "
          "relative to the component's mean motion.")
      .def_readonly("relative", &VbdResidual::relative,
                    "The ratio force / scale; 0 if the force is 0.")
      .def_readonly("floor", &VbdResidual::floor,
                    "The value of `relative` that rounding of the positions to float32 can cause.")
      .def_readonly("iterations", &VbdResidual::iterations, "The number of iterations that ran.");
}

void bind_self_contacts(py::module_& solvers) {
  py::class_<VbdSelfContacts>(
      solvers, "VbdSelfContacts",
      "The contacts between triangles and edges of surfaces at the end of a step of SolverVBD.")
      .def("__len__", [](const VbdSelfContacts& c) { return c.gaps.size(); })
      .def_property_readonly(
          "particles",
          [](const VbdSelfContacts& c) {
            return to_column(reinterpret_cast<const int32_t*>(c.particles.data()),
                             c.particles.size(), 4);
          },
          "int32 {n, 4}: the particles of a vertex and of a triangle, or of two edges.")
      .def_property_readonly(
          "has_edges",
          [](const VbdSelfContacts& c) {
            return to_column(reinterpret_cast<const bool*>(c.has_edges.data()), c.has_edges.size());
          },
          "bool {n}: True: a contact of two edges. False: of a vertex and a triangle.")
      .def_property_readonly(
          "gaps", [](const VbdSelfContacts& c) { return to_column(c.gaps.data(), c.gaps.size()); },
          "float32 {n}: the distance between the two features (m).")
      .def_property_readonly(
          "forces",
          [](const VbdSelfContacts& c) { return to_column(c.forces.data(), c.forces.size()); },
          "float32 {n}: the normal force without damping (N).");
}

void bind_options(py::class_<SolverVBD, SolverBase>& solver) {
  solver
      .def_property_readonly(
          "iterations", [](const SolverVBD& s) { return s.options().iterations; },
          "The number of sweeps over all colors in a step.")
      .def_property_readonly(
          "friction_epsilon", [](const SolverVBD& s) { return s.options().friction_epsilon; },
          "The slip at which friction reaches the Coulomb limit (m/s).")
      .def_property_readonly(
          "initial_guess",
          [](const SolverVBD& s) {
            return kGuesses[static_cast<size_t>(s.options().initial_guess)].first;
          },
          "The initial guess: \"inertia\", \"previous\" or \"adaptive\".")
      .def_property_readonly(
          "acceleration", [](const SolverVBD& s) { return s.options().acceleration; },
          "The spectral radius of Chebyshev acceleration; None: no acceleration.")
      .def_property_readonly(
          "tolerance", [](const SolverVBD& s) { return s.options().tolerance; },
          "The bound of residual().relative at which iterations end; None: no bound.")
      .def_property_readonly(
          "safeguard", [](const SolverVBD& s) { return s.options().safeguard; },
          "Whether the step of a particle is halved as long as it raises the energy.")
      .def_property_readonly(
          "coarse", [](const SolverVBD& s) { return s.options().coarse ? "auto" : nullptr; },
          "The coarse correction: \"auto\" or None.")
      .def_property_readonly(
          "solve",
          [](const SolverVBD& s) { return s.options().converged ? "converged" : "iterations"; },
          "When a step ends: after the \"iterations\", or when it has \"converged\".")
      .def_property_readonly(
          "particle_enable_self_contact",
          [](const SolverVBD& s) { return s.options().self_contact.has_value(); },
          "Whether triangles of surfaces push each other apart.")
      .def_property_readonly(
          "lhs_regularization", [](const SolverVBD& s) { return s.options().lhs_regularization; },
          "The relative regularization of nearly singular blocks (1).");
}

void bind_steps(py::class_<SolverVBD, SolverBase>& solver) {
  solver
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
          py::kw_only(), "targets"_a = py::none(), doc::kVbdStep)
      .def("residual", &SolverVBD::residual, release_gil(), doc::kVbdResidual)
      .def("self_contacts", &SolverVBD::self_contacts, release_gil(),
           "Returns the VbdSelfContacts of the last step. ValueError: the solver was made without "
           "particle_enable_self_contact.")
      .def(
          "joint_forces",
          [](const SolverVBD& s) {
            std::vector<SpatialVectorf> forces;
            {
              const ReleasedGil release;
              forces = s.joint_forces();
            }
            return to_column(reinterpret_cast<const float*>(forces.data()), forces.size(), 6);
          },
          "Returns float32 {joint_count, 6}: the force (N) and the moment (N m) of each joint on "
          "its child at the end of the last step, in the world frame. The force acts at the "
          "child's anchor. Joints without constraints, such as FREE joints and disabled joints, "
          "have zeros. Error: no step ran since the solver was made or reset.")
      .def("reset", &SolverVBD::reset,
           "Clears the data of the last step that initial_guess=\"adaptive\" and residual() use.");
}

}  // namespace

void bind_vbd(py::module_& solvers) {
  bind_residual(solvers);
  bind_self_contacts(solvers);
  const VbdOptions d;
  py::class_<SolverVBD, SolverBase> solver(
      solvers, "SolverVBD",
      "Implicit Euler, solved by Vertex Block Descent (Chen et al. 2024). Steps are stable even "
      "for a large dt and high stiffness. The solver supports particles, springs, triangles, "
      "bending edges, tetrahedra, external forces, gravity, and contacts with world-owned shapes. "
      "On the CPU it also supports rigid bodies with their joints, and with contacts between "
      "bodies "
      "and with particles.\n\nParticles need "
      "colors: call ModelBuilder.color(). Particles of mass 0 or without ParticleFlags.ACTIVE are "
      "kinematic. A step does not write to state_in. The bits are the same for any number of "
      "threads and on a CUDA device.\n\nA step can be captured. On a tape the step raises an error "
      "if an input requires a gradient: use DiffSolverVBD.");
  bind_options(solver);
  solver
      .def(py::init([](const std::shared_ptr<Model>& model, int32_t iterations,
                       float friction_epsilon, const std::string& initial_guess,
                       std::optional<float> acceleration, std::optional<float> tolerance,
                       bool safeguard, const std::optional<std::string>& coarse,
                       const std::string& solve, float lhs_regularization,
                       bool particle_enable_self_contact,
                       std::optional<float> particle_self_contact_radius,
                       std::optional<float> particle_self_contact_margin,
                       std::optional<float> particle_self_contact_gap) {
             return std::make_unique<SolverVBD>(
                 model, VbdOptions{.iterations = iterations,
                                   .friction_epsilon = friction_epsilon,
                                   .initial_guess = to_guess(initial_guess),
                                   .acceleration = acceleration,
                                   .tolerance = tolerance,
                                   .safeguard = safeguard,
                                   .coarse = to_coarse(coarse),
                                   .converged = to_converged(solve),
                                   .lhs_regularization = lhs_regularization,
                                   .self_contact = to_self_contact(
                                       particle_enable_self_contact, particle_self_contact_radius,
                                       particle_self_contact_margin, particle_self_contact_gap)});
           }),
           py::arg("model").none(false), py::kw_only(), "iterations"_a = d.iterations,
           "friction_epsilon"_a = d.friction_epsilon, "initial_guess"_a = "inertia",
           "acceleration"_a = py::none(), "tolerance"_a = py::none(), "safeguard"_a = d.safeguard,
           "coarse"_a = py::none(), "solve"_a = "iterations",
           "lhs_regularization"_a = d.lhs_regularization, "particle_enable_self_contact"_a = false,
           "particle_self_contact_radius"_a = py::none(),
           "particle_self_contact_margin"_a = py::none(),
           "particle_self_contact_gap"_a = py::none(), doc::kVbdInit)
      .def_property_readonly("kinematic_count", &SolverVBD::kinematic_count, kKinematicCountDoc)
      .def_property_readonly("held_count", &old_kinematic_count<SolverVBD>, kHeldCountDoc);
  bind_steps(solver);
#ifdef NOVAPHY_PYTHON_DIFF
  bind_diff_vbd(solvers);
#endif
}

}  // namespace novaphy::python
