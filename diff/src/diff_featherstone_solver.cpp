#include "novaphy/diff/diff_featherstone_solver.h"

#include <algorithm>
#include <cmath>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/on_host.h"
#include "novaphy/dynamics/diff_model_reads.h"
#include "novaphy/dynamics/joint_coordinates.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff {
namespace {

constexpr const char* kUser = "DiffFeatherstoneSolver";
constexpr const char* kStep = "DiffFeatherstoneSolver.step";
constexpr const char* kRollout = "DiffFeatherstoneSolver.rollout";

int32_t most_contacts(const Contacts* contacts) {
  return contacts == nullptr ? 0 : contacts->rigid_contact_max();
}

constexpr std::string_view kFeatherstoneGradients[] = {"body_com",
                                                       "body_mass",
                                                       "body_inertia",
                                                       "joint_f",
                                                       "joint_target_q",
                                                       "joint_target_qd",
                                                       "joint_target_ke",
                                                       "joint_target_kd",
                                                       "joint_limit_lower",
                                                       "joint_limit_upper",
                                                       "joint_limit_ke",
                                                       "joint_limit_kd",
                                                       "joint_damping",
                                                       "joint_armature",
                                                       "joint_effort_limit",
                                                       "joint_velocity_limit",
                                                       "joint_friction",
                                                       "gravity",
                                                       "shape_material_ke",
                                                       "shape_material_kd",
                                                       "shape_material_mu",
                                                       "shape_material_restitution",
                                                       "ctrl",
                                                       "actuator_gear",
                                                       "actuator_wrench",
                                                       "actuator_gain",
                                                       "actuator_bias",
                                                       "actuator_time",
                                                       "actuator_ctrl_range",
                                                       "actuator_force_range",
                                                       "actuator_act_range",
                                                       "body_gravcomp",
                                                       "body_fluid_box",
                                                       "fluid_density",
                                                       "fluid_viscosity",
                                                       "fluid_wind"};

void check_gradients(const Model& m, const Control* control, const Contacts* contacts,
                     bool touching) {
  check_other_gradients(kUser, m, control, contacts, [touching](std::string_view name) {
    const bool is_of_shapes = name.starts_with("shape_") || name.starts_with("mesh_");
    return std::ranges::find(kFeatherstoneGradients, name) != std::end(kFeatherstoneGradients) ||
           (is_of_shapes && !touching);
  });
}

float distance(const Transformf& a, const Transformf& b) {
  const float dot = a.q.x * b.q.x + a.q.y * b.q.y + a.q.z * b.q.z + a.q.w * b.q.w;
  const auto along = [&](float x, float y) { return std::abs(x - std::copysign(1.0f, dot) * y); };
  const float turn = std::max(
      {along(a.q.x, b.q.x), along(a.q.y, b.q.y), along(a.q.z, b.q.z), along(a.q.w, b.q.w)});
  const float size = 1.0f + std::max({std::abs(a.p.x), std::abs(a.p.y), std::abs(a.p.z)});
  const float away =
      std::max({std::abs(a.p.x - b.p.x), std::abs(a.p.y - b.p.y), std::abs(a.p.z - b.p.z)});
  return std::max(turn, away / size);
}

}  // namespace

// Returns whether body_q agrees with joint_q up to rounding. NaN does not agree.
bool DiffFeatherstoneSolver::poses_follow(const SimState& state) {
  const Model& m = *model();
  const nova::NoGrad no_grad;
  const UntrackedScope untracked;
  if (poses_ == nullptr) poses_ = std::make_shared<SimState>(m.state(false));
  eval_fk(m, state.joint_q, state.joint_qd, *poses_);
  const OnHost<Transformf> a(state.body_q), b(poses_->body_q);
  for (size_t k = 0; k < a.size(); ++k)
    if (!(distance(a[k], b[k]) < 1e-5f)) return false;
  return true;
}

DiffFeatherstoneSolver::DiffFeatherstoneSolver(std::shared_ptr<const Model> model,
                                               const FeatherstoneOptions& options,
                                               bool allow_unconverged,
                                               DerivativeOf contact_gradient)
    : DiffSolverBase(std::move(model)),
      options_(options),
      allow_unconverged_(allow_unconverged),
      contact_gradient_(contact_gradient),
      step_(*this->model(), options, kUser, allow_unconverged, contact_gradient) {}

void DiffFeatherstoneSolver::check_contacts(const char* function, const Contacts* contacts,
                                            bool touching) const {
  require(!touching || options_.contact != ArticulationContact::None, ErrorKind::Value, function,
          ", contacts: expected none of a solver without a way of contact");
  require(contacts == nullptr || !contacts->per_contact_shape_properties(),
          ErrorKind::NotImplemented, function,
          ", contacts: expected none with per_contact_shape_properties, which this solver does not "
          "read");
}

void DiffFeatherstoneSolver::notify_model_changed(ModelFlags) {
  const ExclusiveUse::Scope scope = use("DiffFeatherstoneSolver.notify_model_changed");
  step_ = ArticulationStep(*model(), options_, kUser, allow_unconverged_, contact_gradient_);
}

void DiffFeatherstoneSolver::step(SimState& state_in, SimState& state_out, const Control* control,
                                  const Contacts* contacts, float dt) {
  if (&state_in == &state_out) {
    step(state_in, next_state(kStep), control, contacts, dt);
    return take_next(state_in);
  }
  require(!nova::current_capture(), ErrorKind::Runtime, kStep,
          " inside a ScopedCapture: capture rollout instead (supports_graph_capture is False)");
  const ExclusiveUse::Scope scope = use(kStep);
  const Model& m = *model();
  check_step(kStep, state_in, state_out, control, contacts, dt);
  check_contacts(kStep, contacts, contacts != nullptr);
  begin_model_reads(m, kStep);
  check_gradients(m, control, contacts, contacts != nullptr);
  step_.begin(m, control, kStep);
  if (nova::Tape::active() != nullptr) make_leaves(state_in);
  const auto scratch = make_scratch(step_.scratch(m, most_contacts(contacts)), 1, device());
  const bool follow = contacts != nullptr &&
                      contacts->rigid_contacts_found_from(m, state_in.body_q) &&
                      poses_follow(state_in);
  step_.record(m, state_in, state_out, control, contacts,
               follow ? FoundContacts::Now : FoundContacts::Before,
               nova::operand_of(state_in.body_f), dt, scratch[0]);
  step_.check(m, kStep);
}

void DiffFeatherstoneSolver::rollout(Trajectory& trajectory, const Control* control,
                                     const Contacts* contacts, float dt,
                                     const RolloutOptions& options) {
  try {
    DiffSolverBase::rollout(trajectory, control, contacts, dt, options);
    step_.flush();
  } catch (...) {
    step_.forget();
    throw;
  }
  if (!nova::current_capture() && !device().is_cpu()) step_.check(*model(), kRollout);
}

std::vector<ScratchSpec> DiffFeatherstoneSolver::step_scratch() const {
  return step_.scratch(*model(), rollout_contacts_);
}

bool DiffFeatherstoneSolver::begin_rollout(const RolloutInputs& inputs) {
  const bool touching = inputs.contacts() != nullptr || inputs.pipeline() != nullptr;
  check_contacts(kRollout, inputs.contacts(), touching);
  rollout_contacts_ = most_contacts(inputs.contacts());
  if (inputs.pipeline() != nullptr) {
    const UntrackedScope untracked;  // a capture does not record this memory
    const Contacts contacts = inputs.pipeline()->contacts();
    rollout_contacts_ = most_contacts(&contacts);
  }
  begin_model_reads(*model(), kRollout);
  step_.count_from(inputs.start());
  for (int32_t t = inputs.start(); t < inputs.stop(); ++t)
    if (t == inputs.start() || inputs.control(t) != inputs.control(t - 1)) {
      check_gradients(*model(), inputs.control(t), inputs.contacts(), touching);
      step_.begin(*model(), inputs.control(t), kRollout);
    }
  return true;
}

void DiffFeatherstoneSolver::record_step(const SimState& in, SimState& out,
                                         const StepInputs& inputs, StepScratch scratch) {
  // The search reads body_q. The user writes joint_q of the first state, and may leave body_q as it
  // was. A step gives all later states their body_q.
  const bool is_written = inputs.is_first && nova::current_capture() == nullptr;
  const auto found = inputs.tables == nullptr          ? FoundContacts::Before
                     : !is_written || poses_follow(in) ? FoundContacts::Always
                                                       : FoundContacts::BeforeAgain;
  step_.record(*model(), in, out, inputs.control, inputs.contacts, found, inputs.body_forces,
               inputs.dt, scratch, inputs.checkpoints == nullptr);
  // On a device a failing step writes NaN, and the rollout reports it at its end. On the host the
  // failing step raises and leaves its state unchanged.
  if (nova::host_can_read(device())) step_.check(*model(), kRollout);
}

}  // namespace novaphy::diff
