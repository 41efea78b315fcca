#include "novaphy/vbd/solver_vbd.h"

#include <cmath>
#include <utility>

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
  require(model.device().is_cpu(), ErrorKind::NotImplemented,
          "SolverVBD: model: expected one on the cpu, got one on ", model.device().str());
}

}  // namespace

struct SolverVBD::Work : vbd::StepWork {
  using vbd::StepWork::StepWork;
};

SolverVBD::SolverVBD(std::shared_ptr<const Model> model, const VbdOptions& options)
    : SolverBase(std::move(model)), options_(options) {
  check_options(options);
  check_covered(*this->model());
  this->model()->update_derived();
  work_ = std::make_unique<Work>(*this->model(), options);
}

SolverVBD::~SolverVBD() = default;

int32_t SolverVBD::held_count() const { return static_cast<int32_t>(work_->slots.held().size()); }

void SolverVBD::notify_model_changed(ModelFlags) {
  const ExclusiveUse::Scope scope = use("SolverVBD.notify_model_changed");
  model()->update_derived();
  work_->build();
}

void SolverVBD::reset() {
  const ExclusiveUse::Scope scope = use("SolverVBD.reset");
  work_->has_last = work_->has_stepped = false;
}

VbdResidual SolverVBD::residual() const {
  const ExclusiveUse::Scope scope = use("SolverVBD.residual");
  require(work_->has_stepped, ErrorKind::Runtime,
          "SolverVBD.residual: expected a step before, since the solver was made or reset");
  return work_->residual();
}

void SolverVBD::step(SimState& state_in, SimState& state_out, const Control* control,
                     const Contacts* contacts, float dt, const DeviceArray<Vec3f>* targets) {
  if (ArrayObserver* observer = array_observer()) observer->untracked_operation(kName);
  const ExclusiveUse::Scope scope = use(kName);
  const Model& m = *model();
  Work& w = *work_;
  check_step(kName, state_in, state_out, control, contacts, dt);
  m.update_derived();
  w.update(control != nullptr ? &control->particle_tri_activation : nullptr,
           control != nullptr ? &control->particle_tet_activation : nullptr, contacts, dt);
  const auto held = w.slots.held().size();
  require(targets == nullptr || (targets->rows() == held && targets->device() == m.device()),
          ErrorKind::Value, kName, ": targets: expected {", held,
          ", 3}, a position for every held particle, got ",
          targets == nullptr ? 0 : targets->rows(), " rows");

  w.run({state_in.particle_q.data(), state_in.particle_qd.data(), state_in.particle_f.data(),
         state_out.particle_q.mutable_data(), state_out.particle_qd.mutable_data()},
        targets == nullptr ? nullptr : targets->data());
}

}  // namespace novaphy
