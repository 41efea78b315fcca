#include "novaphy/vbd/solver_vbd.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "bodies.h"
#include "element_arrays.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/enums.h"
#include "step.h"
#include "step_tangent.h"

namespace novaphy {
namespace {

constexpr const char* kName = "SolverVBD.step";

void check_options(const VbdOptions& o) {
  constexpr const char* name = "SolverVBD: ";
  require(o.iterations >= 0, ErrorKind::Value, name, "iterations: expected >= 0, got ",
          o.iterations);
  require(std::isfinite(o.friction_epsilon) && o.friction_epsilon > 0.0f, ErrorKind::Value, name,
          "friction_epsilon: expected a finite number > 0, got ", o.friction_epsilon);
  require(
      o.initial_guess >= VbdInitialGuess::Inertia && o.initial_guess <= VbdInitialGuess::Adaptive,
      ErrorKind::Value, name, "initial_guess: expected a VbdInitialGuess, got ",
      static_cast<int>(o.initial_guess));
  if (o.acceleration)
    require(*o.acceleration > 0.0f && *o.acceleration < 1.0f, ErrorKind::Value, name,
            "acceleration: expected a spectral radius in (0, 1), or none, got ", *o.acceleration);
  if (o.tolerance)
    require(std::isfinite(*o.tolerance) && *o.tolerance > 0.0f, ErrorKind::Value, name,
            "tolerance: expected a finite number > 0, or none, got ", *o.tolerance);
  require(!o.safeguard || !o.acceleration, ErrorKind::Value, name,
          "safeguard: expected no acceleration besides, which may raise the energy");
  require(std::isfinite(o.lhs_regularization) && o.lhs_regularization >= 0.0f, ErrorKind::Value,
          name, "lhs_regularization: expected a finite number >= 0, got ", o.lhs_regularization);
}

// Raises an error for options that are not supported together with self-contact.
void check_self_contact(const VbdOptions& o) {
  if (!o.self_contact) return;
  const std::pair<const char*, bool> others[] = {{"acceleration", o.acceleration.has_value()},
                                                 {"tolerance", o.tolerance.has_value()},
                                                 {"safeguard", o.safeguard},
                                                 {"solve=\"converged\"", o.converged}};
  for (const auto& [name, is_given] : others)
    require(!is_given, ErrorKind::NotImplemented, "SolverVBD: ", name,
            ": not supported together with particle_enable_self_contact");
}

// Returns the options with `coarse` only where it has an effect.
VbdOptions with_coarse(VbdOptions o, const Model& m) {
  const std::vector<int32_t> bodies = m.body_flags.to_host();
  const bool dynamic = std::any_of(bodies.begin(), bodies.end(), [](int32_t flags) {
    return !has_flag(flags, BodyFlags::KINEMATIC);
  });
  o.coarse = o.coarse && !o.acceleration && !o.safeguard && !o.self_contact && !dynamic;
  return o;
}

// Returns the options of the iterations. With `converged` all iterations run, because the tolerance
// is meant for the solution by Newton's method.
VbdOptions options_of_step(VbdOptions o) {
  if (o.converged) o.tolerance.reset();
  return o;
}

}  // namespace

struct SolverVBD::Work {
  Work(const Model& m, const VbdOptions& o) : step(m, options_of_step(o), o.converged) {
    if (m.body_count() > 0) {
      bodies.emplace(m, o);
      last = bodies->of_particles();
    } else if (o.initial_guess == VbdInitialGuess::Adaptive) {
      last = DeviceArray<Vec4f>(static_cast<size_t>(m.particle_count()), m.device());
    }
  }
  // Iterates a step that has run to its solution.
  void solve(const VbdOptions& o) {
    step.check();
    constexpr int32_t kNewtonIterations = 200;  // a pressed sheet buckles for more than 30
    const VbdGradientOptions limits;
    const auto tolerance = static_cast<double>(o.tolerance.value_or(limits.tolerance));
    tangent.solve_step(tolerance, kNewtonIterations, limits.krylov_sweeps)
        .check(kName, tolerance, kNewtonIterations, "iterations");
  }

  void reserve(int32_t contacts) {
    bodies->reserve(contacts);
    last = bodies->of_particles();
  }

  vbd::Step step;
  vbd::StepTangent tangent{step};
  std::optional<vbd::Bodies> bodies;  // empty: the model has no bodies
  // previous velocity for the adaptive guess (see VbdStepInputs); without rows: not used
  DeviceArray<Vec4f> last;
  bool has_stepped = false;
};

SolverVBD::SolverVBD(std::shared_ptr<const Model> model, const VbdOptions& options)
    : SolverBase(std::move(model)), options_(with_coarse(options, *this->model())) {
  check_options(options);
  check_self_contact(options);
  this->model()->update_derived();
  work_ = std::make_unique<Work>(*this->model(), options_);
}

SolverVBD::~SolverVBD() = default;

int32_t SolverVBD::kinematic_count() const { return work_->step.kinematic_count(); }

Array SolverVBD::carried() const { return work_->bodies ? work_->bodies->memory() : work_->last; }

void SolverVBD::rollout(Trajectory& trajectory, const Control* control, const Contacts* contacts,
                        float dt, const RolloutOptions& options) {
  if (work_->bodies && contacts != nullptr) work_->reserve(contacts->rigid_contact_max());
  if (work_->bodies && options.pipeline != nullptr)
    work_->reserve(options.pipeline->contacts().rigid_contact_max());
  SolverBase::rollout(trajectory, control, contacts, dt, options);
}

bool SolverVBD::supports_graph_capture() const {
  return !options_.tolerance && !options_.converged && !options_.self_contact && !work_->bodies;
}

void SolverVBD::notify_model_changed(ModelFlags) {
  const ExclusiveUse::Scope scope = use("SolverVBD.notify_model_changed");
  model()->update_derived();
  work_->step.build();
}

void SolverVBD::reset() {
  const ExclusiveUse::Scope scope = use("SolverVBD.reset");
  work_->has_stepped = false;
  if (work_->last.rows() != 0) work_->last.zero();
  if (work_->bodies) work_->bodies->reset();
}

VbdSelfContacts SolverVBD::self_contacts() const {
  const ExclusiveUse::Scope scope = use("SolverVBD.self_contacts");
  const vbd::SelfContact* const contact = work_->step.self_contact();
  require(contact != nullptr, ErrorKind::Value,
          "SolverVBD.self_contacts: expected particle_enable_self_contact True, got False");
  return contact->contacts();
}

std::vector<SpatialVectorf> SolverVBD::joint_forces() const {
  const ExclusiveUse::Scope scope = use("SolverVBD.joint_forces");
  require(work_->has_stepped, ErrorKind::Runtime,
          "SolverVBD.joint_forces: expected a step before, since the solver was made or reset");
  if (!work_->bodies) return {};
  return work_->bodies->joint_forces();
}

VbdResidual SolverVBD::residual() const {
  const ExclusiveUse::Scope scope = use("SolverVBD.residual");
  work_->step.check();
  require(work_->has_stepped, ErrorKind::Runtime,
          "SolverVBD.residual: expected a step before, since the solver was made or reset");
  return work_->step.residual();
}

void SolverVBD::step(SimState& state_in, SimState& state_out, const Control* control,
                     const Contacts* contacts, float dt, const DeviceArray<Vec3f>* targets) {
  if (&state_in == &state_out) {
    step(state_in, next_state(kName), control, contacts, dt, targets);
    return take_next(state_in);
  }
  const ExclusiveUse::Scope scope = use(kName);
  const Model& m = *model();
  Work& w = *work_;
  check_step(kName, state_in, state_out, control, contacts, dt);
  const auto kinematic = static_cast<size_t>(kinematic_count());
  require(targets == nullptr || (targets->rows() == kinematic && targets->device() == m.device()),
          ErrorKind::Value, kName, ": targets: expected {", kinematic,
          ", 3}, a position for every kinematic particle, got ",
          targets == nullptr ? 0 : targets->rows(), " rows");
  const LaunchRecorder* const recorder = launch_recorder();
  require(recorder == nullptr || !recorder->has_tape() || !state_in.requires_grad,
          ErrorKind::Runtime, kName,
          " on an active Tape: state_in: expected requires_grad False, because its gradient would "
          "silently stop here; take DiffSolverVBD, or nova.no_grad()");
  {
    const UntrackedScope of_the_model;
    m.update_derived();
  }
  VbdStepInputs inputs;
  inputs.q = state_in.particle_q;
  inputs.qd = state_in.particle_qd;
  inputs.f = state_in.particle_f;
  inputs.activations = vbd::activations_of(control, m);
  inputs.contacts = contacts;
  if (targets != nullptr) inputs.targets = *targets;
  inputs.dt = dt;
  inputs.last_velocity = w.last;
  w.step.update(dt);
  if (w.bodies) {
    require(runs_at_once(m.device()), ErrorKind::NotImplemented, kName,
            ": expected no capture and no tape for a model with bodies");
    m.check_structure(kName);
    if (contacts != nullptr) w.reserve(contacts->rigid_contact_max());
    inputs.last_velocity = w.last;
    w.bodies->begin(state_in, control, contacts, dt);
  }
  w.step.run(
      inputs,
      {.q = state_out.particle_q, .qd = state_out.particle_qd, .updates_last = w.last.rows() != 0},
      in_use(), w.bodies ? &*w.bodies : nullptr);
  if (w.bodies) w.bodies->finish(state_in, state_out, contacts);
  w.has_stepped = true;
  if (options_.converged) w.solve(options_);
}

}  // namespace novaphy
