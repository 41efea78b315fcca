#include "novaphy/vbd/solver_vbd.h"

#include <cmath>
#include <utility>

#include "launched_step.h"
#include "novaphy/core/error.h"
#include "step_work.h"

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

void check_covered(const Model& model) {
  const auto check = [](const char* name, int32_t count) {
    require(count == 0, ErrorKind::NotImplemented, "SolverVBD: model: expected ", name,
            " 0 (they are not there yet), got ", count);
  };
  check("body_count", model.body_count());
  check("joint_count", model.joint_count());
  check("articulation_count", model.articulation_count());
}

}  // namespace

// A step runs on the host where it can, with all its lanes; on devices, and while something records
// what this thread does, as launches.
struct SolverVBD::Work {
  Work(const Model& m, const VbdOptions& o) : model(m), options(o) {
    if (o.initial_guess == VbdInitialGuess::Adaptive)
      last = DeviceArray<Vec4f>(static_cast<size_t>(m.particle_count()), m.device());
    if (m.device().is_cpu()) {
      host = std::make_unique<vbd::StepWork>(m, o);
    } else {
      launched = std::make_unique<vbd::LaunchedStep>(m, o);
    }
  }
  vbd::LaunchedStep& recorded() {
    if (launched == nullptr) launched = std::make_unique<vbd::LaunchedStep>(model, options);
    return *launched;
  }

  const Model& model;
  const VbdOptions options;
  std::unique_ptr<vbd::StepWork> host;  // null: on a device
  std::unique_ptr<vbd::LaunchedStep> launched;
  DeviceArray<Vec4f> last;  // of the adaptive guess, see VbdStepInputs; else without rows
  bool last_was_launched = false;
};

SolverVBD::SolverVBD(std::shared_ptr<const Model> model, const VbdOptions& options)
    : SolverBase(std::move(model)), options_(options) {
  check_options(options);
  check_covered(*this->model());
  this->model()->update_derived();
  work_ = std::make_unique<Work>(*this->model(), options);
}

SolverVBD::~SolverVBD() = default;

int32_t SolverVBD::held_count() const {
  return work_->host != nullptr ? static_cast<int32_t>(work_->host->slots.held().size())
                                : work_->launched->held_count();
}

Array SolverVBD::carried() const { return work_->last; }

bool SolverVBD::supports_graph_capture() const { return !options_.tolerance; }

void SolverVBD::notify_model_changed(ModelFlags) {
  const ExclusiveUse::Scope scope = use("SolverVBD.notify_model_changed");
  model()->update_derived();
  if (work_->host != nullptr) work_->host->build();
  if (work_->launched != nullptr) work_->launched->build();
}

void SolverVBD::reset() {
  const ExclusiveUse::Scope scope = use("SolverVBD.reset");
  if (work_->host != nullptr) work_->host->has_stepped = false;
  if (work_->launched != nullptr) work_->launched->forget_last();
  if (work_->last.rows() != 0) work_->last.zero();
}

VbdResidual SolverVBD::residual() const {
  const ExclusiveUse::Scope scope = use("SolverVBD.residual");
  Work& w = *work_;
  if (w.launched != nullptr) w.launched->check();
  const bool launched = w.host == nullptr || w.last_was_launched;
  require(launched ? w.launched->has_stepped() : w.host->has_stepped, ErrorKind::Runtime,
          "SolverVBD.residual: expected a step before, since the solver was made or reset");
  return launched ? w.launched->residual() : w.host->residual();
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
  if (w.host != nullptr && w.launched != nullptr) w.launched->check();  // of replays; no waiting
  const auto held = static_cast<size_t>(held_count());
  require(targets == nullptr || (targets->rows() == held && targets->device() == m.device()),
          ErrorKind::Value, kName, ": targets: expected {", held,
          ", 3}, a position for every held particle, got ",
          targets == nullptr ? 0 : targets->rows(), " rows");
  const LaunchRecorder* const recorder = launch_recorder();
  require(recorder == nullptr || !recorder->has_tape() || !state_in.requires_grad,
          ErrorKind::Runtime, kName,
          " on an active Tape: state_in: expected requires_grad False, because its gradient would "
          "silently stop here; take DiffSolverVBD, or nova.no_grad()");
  {
    const Unobserved of_the_model;
    m.update_derived();
  }
  w.last_was_launched = w.host == nullptr || recorder != nullptr;
  if (w.last_was_launched) {
    vbd::LaunchedStep& step = w.host == nullptr ? *w.launched : w.recorded();
    step.update(dt);
    VbdLaunchInputs inputs;
    inputs.q = state_in.particle_q;
    inputs.qd = state_in.particle_qd;
    inputs.f = state_in.particle_f;
    inputs.tri_activation =
        control != nullptr ? control->particle_tri_activation : m.particle_tri_activation;
    inputs.tet_activation =
        control != nullptr ? control->particle_tet_activation : m.particle_tet_activation;
    inputs.contacts = contacts;
    if (targets != nullptr) inputs.targets = *targets;
    inputs.last_velocity = w.last;
    return step.run(inputs,
                    {.q = state_out.particle_q, .qd = state_out.particle_qd, .updates_last = true},
                    in_use());
  }
  w.host->update(control != nullptr ? &control->particle_tri_activation : nullptr,
                 control != nullptr ? &control->particle_tet_activation : nullptr, contacts, dt);
  w.host->run({state_in.particle_q.data(), state_in.particle_qd.data(), state_in.particle_f.data(),
               state_out.particle_q.mutable_data(), state_out.particle_qd.mutable_data(),
               w.last.rows() != 0 ? w.last.data() : nullptr},
              targets == nullptr ? nullptr : targets->data());
  if (w.last.rows() == 0) return;
  const Vec3f* const qd = state_in.particle_qd.data();
  Vec4f* const last = w.last.mutable_data();
  for (size_t p = 0; p < w.last.rows(); ++p) last[p] = {qd[p].x, qd[p].y, qd[p].z, 1.0f};
}

}  // namespace novaphy
