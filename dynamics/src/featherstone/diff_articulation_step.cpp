#include "novaphy/dynamics/featherstone/diff_articulation_step.h"

#include <utility>

#include "diff_articulation_motion.h"
#include "diff_articulation_parts.h"
#include "novaphy/core/sim/on_host.h"
#include "novaphy/dynamics/diff_gradient_notes.h"

namespace novaphy::diff {

using namespace detail;

namespace {

ContactBranches all_branches(const ArticulationStep::Shared& shared) {
  ContactBranches b = shared.trees ? shared.branches : shared.contacts.branches();
  b.all.steps += shared.free_steps;
  b.all.exact += shared.free_steps;
  return b;
}

constexpr int32_t kLeastSweeps = 1000;  // minimum of pgs_iterations, because the adjoint needs
                                        // converged impulses

nova::CustomOp make_op(const std::shared_ptr<const Step>& step) {
  nova::CustomOp op{.name = kName, .inputs = {}, .outputs = {}, .vjp = nullptr};
  for (const Named& in : step->inputs)
    if (in.tensor.defined()) op.inputs.push_back(in.tensor);
  op.reads = op.inputs;
  for (const Named& value : step->values) op.reads.push_back(value.tensor);
  if (step->inputs[kMu].tensor.defined()) op.reads.push_back(tensor_of(step->model->shape_mixing));
  // A single step may run again from a checkpoint, so qdd and branch are outputs too.
  const bool single = step->following.empty();
  const auto add_step = [&](const StepOutputs& out) {
    op.outputs.insert(op.outputs.end(), out.begin(), out.begin() + (single ? 6 : 4));
    for (const size_t i : {0, 1, 4, 5}) op.reads.push_back(out[i]);
  };
  add_step(outputs_of(*step));
  for (const StepOutputs& out : step->following) add_step(out);
  // The step also reads its contacts from this memory. No other operation writes it, and each run
  // of the step stores the same contacts there.
  if (step->contacts.defined()) op.writes.push_back(step->contacts);
  op.writes.push_back(tensor_of(step->status));
  if (step->stride > 0) op.writes.push_back(tensor_of(step->workspace));
  // Outside of captures the CPU runs at once, after all submitted work.
  op.submits_only = !step->shared->runs_on_host();
  op.vjp = [step](std::span<const Tensor> outputs, std::span<const nova::InputGradient> inputs) {
    const auto run = [&](std::span<const nova::InputGradient> to) {
      if (step->motion && !holds_times(*step))
        motion_vjp(*step, outputs, to,
                   [&](std::span<const nova::InputGradient> of) { submit_vjp(step, outputs, of); });
      else if (step->following.empty())
        submit_vjp(step, outputs, to);
      else
        run_vjp_of_steps(*step, outputs, to);
    };
    if (AdjointRecord* const record = AdjointRecord::current())
      record_vjp(*step, outputs, inputs, run, *record);
    else
      run(inputs);
  };
  op.forward = [step] { run_all(step); };
  op.jvp = [step](std::span<const Tensor> inputs, std::span<const Tensor> outputs) {
    if (!step->motion || holds_times(*step)) return submit_jvp(step, inputs, outputs);
    motion_jvp(*step, inputs, outputs,
               [&](std::span<const Tensor> from) { submit_jvp(step, from, outputs); });
  };
  return op;
}

Named view(const char* name, const Array& array) { return {name, tensor_of(array)}; }

void set_arrays(Step& s, const SimState& in, const SimState& out, const StepDrives& drives,
                const nova::Operand& body_f, StepScratch scratch) {
  const Model& m = *s.model;
  NamedStepArrays arrays = step_arrays(m, &in, nullptr);
  read_instead(arrays, drives);
  for (size_t i = 0; i < kStepArrays; ++i) {
    Named& to = i < kGradientArrays ? s.inputs[i] : s.values[i - kGradientArrays];
    to = view(arrays[i].name, *arrays[i].array);
  }
  s.inputs[kAt.body_f].tensor = {body_f.range, {body_f.rows, body_f.width}, nova::DType::F32};
  s.inputs[kJointFriction] = view("joint_friction", m.joint_friction);
  const Articulations& a = s.shared->articulations;
  s.values[kTargetMode] = view("model.joint_target_mode", m.joint_target_mode);
  s.values[kRows] = view("rows", a.rows());
  s.values[kLinks] = view("links", a.links());
  s.values[kDofParent] = view("dof_parent", a.dof_parent());
  s.outputs = {view("joint_q", out.joint_q), view("joint_qd", out.joint_qd),
               view("body_q", out.body_q),   view("body_qd", out.body_qd),
               view("qdd", scratch[0]),      view("branch", scratch[1])};
}

void set_contacts(Step& s, const Contacts& contacts, FoundContacts found) {
  s.contact_max = contacts.rigid_contact_max();
  const bool again = found == FoundContacts::Always || found == FoundContacts::BeforeAgain;
  if (again || nova::current_capture() != nullptr) s.found.emplace(contacts);
  s.force = contacts.rigid_contact_force;
  s.point_id = contacts.rigid_contact_point_id;
  const Model& m = *s.model;
  s.inputs[kMu] = view("shape_material_mu", m.shape_material_mu);
  s.inputs[kRestitution] = view("shape_material_restitution", m.shape_material_restitution);
  s.inputs[kStiffness] = view("shape_material_ke", m.shape_material_ke);
  s.inputs[kDamping] = view("shape_material_kd", m.shape_material_kd);
}

}  // namespace

// Reports the gradients of the steps on a tape. On the CPU each tape has its own counts. Replays
// and devices share the counts of all steps.
struct ArticulationStep::Shared::Witness : GradientWitness {
  std::shared_ptr<Shared> shared;
  GradientCounts counts;
  MotionCounts motion;
  bool has_replays;
  Witness(std::shared_ptr<Shared> of, bool replays)
      : shared(std::move(of)), motion(shared->no_motion()), has_replays(replays) {}
  MotionEvents events() const override { return motion.events; }
  bool has_events() const override { return shared->moves() && motion.held == nullptr; }
  GradientInfo info() const override {
    MotionCounts of = motion;
    if (of.held == nullptr) of.held = shared->motion.held;
    return gradient_info(has_replays ? all_branches(*shared).all : counts, false,
                         shared->contact_gradient == DerivativeOf::Code ? nullptr : &of);
  }
  const char* without_record() const override {
    return shared->runs_on_host() ? nullptr : "DiffFeatherstoneSolver on a device";
  }
};

namespace {

// Scope guard: while it exists, the counts of a step are also added to the witness of the step's
// tape.
class CountsOfStep {
 public:
  explicit CountsOfStep(const std::shared_ptr<ArticulationStep::Shared>& shared)
      : shared_(*shared) {
    if (nova::Tape::active() == nullptr) return;
    witness_ = witness_on_tape(shared->witness, [&] {
      return std::make_shared<ArticulationStep::Shared::Witness>(shared, !shared->runs_on_host());
    });
    counts_ = std::exchange(shared_.branches.all, {});
    motion_.several = shared_.motion.several;
    motion_.unmoved = shared_.motion.unmoved;
    motion_.phased = shared_.motion.phased;
    motion_.searched = shared_.motion.searched;
    motion_.moved = shared_.motion.moved;
    motion_.inexact = shared_.motion.inexact;
    free_steps_ = shared_.free_steps;
  }
  CountsOfStep(const CountsOfStep&) = delete;
  CountsOfStep& operator=(const CountsOfStep&) = delete;
  // Notes that the step holds the times of events.
  void hold(const char* where) { shared_.motion.held = witness_->motion.held = where; }
  ~CountsOfStep() {
    if (!witness_) return;
    GradientCounts now = std::exchange(shared_.branches.all, counts_);
    note_steps(now, shared_.branches.all);
    const int64_t free = shared_.free_steps - free_steps_;
    now.steps += free;
    now.exact += free;
    note_steps(now, witness_->counts);
    witness_->motion.several += shared_.motion.several - motion_.several;
    witness_->motion.unmoved += shared_.motion.unmoved - motion_.unmoved;
    witness_->motion.phased += shared_.motion.phased - motion_.phased;
    witness_->motion.searched += shared_.motion.searched - motion_.searched;
    witness_->motion.chain = shared_.motion.chain;
    witness_->motion.chain_steps = shared_.motion.chain_steps;
    witness_->motion.moved += shared_.motion.moved - motion_.moved;
    witness_->motion.inexact += shared_.motion.inexact - motion_.inexact;
    if (shared_.last_listed != nullptr)
      for (const auto& event : *std::exchange(shared_.last_listed, nullptr))
        witness_->motion.add(event);
  }

 private:
  ArticulationStep::Shared& shared_;
  std::shared_ptr<ArticulationStep::Shared::Witness> witness_;
  GradientCounts counts_;
  MotionCounts motion_;
  int64_t free_steps_ = 0;
};

// Stores the events of a step that has run, and remembers the step as the one before the next.
// Returns whether it forgets an earlier step: the contacts of other steps have come between.
bool note(ArticulationStep::Shared& shared, const std::shared_ptr<const Step>& step) {
  std::shared_ptr<const Step> before = take_before(shared, step);
  const bool forgets = before != nullptr && step->contacts.defined() && !step->continues;
  if (forgets) before = nullptr;
  if (before == nullptr) ++shared.chain;
  // The event list covers consecutive steps only.
  if (before == nullptr || before != shared.last.lock()) shared.motion.events.clear();
  note_motion(step, before);
  note_drift(*step, before.get());
  step->motion->order = shared.moving_steps++;
  step->motion->drifts[0] = shared.motion.drift;
  if (const auto witness = shared.witness.lock()) step->motion->drifts[1] = witness->motion.drift;
  if (step->motion->moves()) ++shared.motion.moved;
  const auto& touched = step->motion->found.touched;
  const bool exact = shared.options.pgs_slop == 0.0f && shared.options.pgs_erp == 1.0f;
  const bool touches = std::any_of(touched.begin(), touched.end(), [](char t) { return t != 0; });
  if (touches && !exact) ++shared.motion.inexact;
  shared.motion.chain = step->motion->chain;
  shared.motion.chain_steps = step->motion->number + 1;
  for (const auto& event : step->motion->listed) shared.motion.add(event);
  shared.last_listed = &step->motion->listed;
  shared.last = step;
  return forgets;
}

}  // namespace

ArticulationStep::ArticulationStep(const Model& model, const FeatherstoneOptions& options,
                                   const char* user, bool allow_unconverged,
                                   DerivativeOf contact_gradient) {
  check_featherstone_model(model, options, user);
  require(model.joint_dof_count() > 0, ErrorKind::Value, user,
          ": model: expected joints with degrees of freedom, got none");
  require(options.contact != ArticulationContact::Penalty, ErrorKind::NotImplemented, user,
          ": contact: expected pgs or none, penalty contacts have no gradient");
  FeatherstoneOptions converged = options;
  converged.warm_start = false;
  converged.pgs_iterations = std::max(options.pgs_iterations, kLeastSweeps);
  shared_ = std::make_shared<Shared>(model, converged, user);
  shared_->allow_unconverged = allow_unconverged;
  shared_->contact_gradient = contact_gradient;
  if (contact_gradient == DerivativeOf::Motion)
    require_cpu(model.device(), user, ": contact_gradient \"motion\"");
  require(contact_gradient != DerivativeOf::Motion || !options.compliant_contacts,
          ErrorKind::NotImplemented, user,
          ": contact_gradient: \"motion\" is not supported with compliant_contacts; use \"code\"");
  shared_->without_motion = !shared_->trees              ? "on a device"
                            : options.compliant_contacts ? "with compliant_contacts"
                                                         : nullptr;
  shared_->motion = shared_->no_motion();
}
ArticulationStep::~ArticulationStep() = default;
ArticulationStep::ArticulationStep(ArticulationStep&&) noexcept = default;
ArticulationStep& ArticulationStep::operator=(ArticulationStep&&) noexcept = default;

std::vector<ScratchSpec> ArticulationStep::scratch(const Model& model, int32_t contact_max) const {
  const auto dofs = static_cast<size_t>(model.joint_dof_count());
  std::vector<ScratchSpec> specs = {{novaphy::DType::float32, dofs, 1},
                                    {novaphy::DType::float32, dofs, 1}};
  if (contact_max > 0 || shared_->dry)
    specs.push_back({novaphy::DType::float32,
                     static_cast<size_t>(KeptContacts::size(contact_max, model.joint_dof_count())),
                     1});
  if (shared_->actuators->any())
    for (const Array& drive : drives_of(model, nullptr))
      specs.push_back({novaphy::DType::float32, drive.rows(), 1});
  const auto bodies = static_cast<size_t>(model.body_count());
  if (shared_->actuators->on_bodies() != nullptr)
    specs.push_back({novaphy::DType::spatial_vector, bodies, 1});
  if (shared_->actuators->lifts()) specs.push_back({novaphy::DType::spatial_vector, bodies, 1});
  return specs;
}

void ArticulationStep::begin(const Model& model, const Control* control, const char* function) {
  if (!shared_->failure.empty())
    fail(ErrorKind::Runtime, function,
         ": a replay of a captured step failed, its results are NaN: ",
         std::exchange(shared_->failure, {}));
  shared_->articulations.check_values(model, control, true, function);
  shared_->mimics.check(model, shared_->options, function);
  const nova::Tape* const tape = nova::Tape::active();
  const auto carries = [&](const Array& array) {
    return tape != nullptr && tape->carries_gradient(*array.range());
  };
  shared_->actuators->check(model, function, carries(model.body_gravcomp),
                            carries(model.fluid_density) || carries(model.fluid_viscosity));
  shared_->dry = carries(model.joint_friction);
  shared_->dry = shared_->dry || shared_->contacts.has_friction();
  if (shared_->trees || shared_->dry)  // the step reads joint_friction
    depend_on_modes(model, control);
  else
    depend_on_values(model, control);
}

void ArticulationStep::record(const Model& m, const SimState& in, SimState& out,
                              const Control* control, const Contacts* contacts, FoundContacts found,
                              const nova::Operand& body_f, float dt, StepScratch scratch,
                              bool join) {
  CountsOfStep counts(shared_);
  const int64_t number = shared_->next_step++;
  const bool may_move = shared_->moves() && nova::Tape::active() != nullptr;
  const bool touching = contacts != nullptr && contacts->rigid_contact_max() > 0;
  const bool captures = nova::current_capture() != nullptr, is_auto = shared_->is_auto();
  require(!may_move || is_auto || !captures, ErrorKind::NotImplemented, kName,
          ": contact_gradient: \"motion\" is not supported inside a ScopedCapture; use \"code\"");
  const bool moves = may_move && !captures && (touching || !is_auto);
  if (may_move && !moves) counts.hold(captures ? "inside a ScopedCapture" : "without contacts");
  const bool is_actuated = shared_->actuators->acts();
  join = join && !moves && !is_actuated;
  if (join && pending_ && joins(m, in, out, control, body_f, dt, scratch)) return;
  flush();
  const Articulations& a = shared_->articulations;
  const auto [drives, wrench] =
      submit_actuation(shared_->actuators, m, in, out, control, body_f, dt,
                       is_actuated ? scratch.subspan(touching || shared_->dry ? 3 : 2) : scratch);
  auto step = std::make_shared<Step>();
  step->shared = shared_;
  step->model = m.shared_from_this();
  step->follow = found == FoundContacts::Now || found == FoundContacts::Always;
  step->continues = shared_->ended == in.joint_q.range()->data();
  const nova::Tape* const tape = nova::Tape::active();
  step->by_restitution =
      tape != nullptr && tape->carries_gradient(*m.shape_material_restitution.range());
  step->dry = shared_->dry;
  step->options = shared_->options;
  step->dt = dt;
  step->count = a.count();
  shared_->reserve(touching || shared_->dry);
  step->stride = shared_->stride;
  step->status = shared_->status;
  step->workspace = shared_->workspace;
  set_arrays(*step, in, out, drives, wrench, scratch);
  if (touching || shared_->dry) step->contacts = tensor_of(scratch[2]);
  if (touching) set_contacts(*step, *contacts, found);
  step->number = number;
  step->far = shared_->far;
  if (touching) shared_->materials.check(m);
  const bool solves = step->contacts.defined();
  shared_->ended = solves ? out.joint_q.range()->data() : nullptr;
  if (!solves) ++shared_->free_steps;
  if (solves && !step->copies_contacts()) {
    const Unrecorded unrecorded(shared_->runs_on_host());
    shared_->contacts.copy(contact_arguments(*contacts), kept_arguments(*step));
  }
  if (moves) step->motion = std::make_shared<MotionNotes>();
  submit_forward(step, true);
  if (nova::Tape::active() == nullptr) return;
  if (moves && note(*shared_, step)) counts.hold("in loops of one solver that alternate");
  pending_ = std::move(step);
  if (!join || solves || !shared_->runs_on_host()) return flush();
  pending_->host = step_arguments_of(*pending_);
}

// Adds the step to the pending operation, which is not recorded yet, and runs it. Returns false,
// and does nothing, if the step does not fit into that operation.
bool ArticulationStep::joins(const Model& m, const SimState& in, SimState& out,
                             const Control* control, const nova::Operand& body_f, float dt,
                             StepScratch scratch) {
  Step& first = *pending_;
  const auto same = [&](int32_t place, const std::shared_ptr<Range>& range) {
    return first.in(static_cast<size_t>(place)).range()->data() == range->data();
  };
  bool same_inputs = same(kAt.body_f, body_f.range);
  const NamedStepArrays arrays = step_arrays(m, &in, control);
  for (const int32_t i : {kAt.joint_f, kAt.target_q, kAt.target_qd})
    same_inputs = same_inputs && same(i, arrays[static_cast<size_t>(i)].array->range());
  const StepOutputs from = first.following.empty() ? outputs_of(first) : first.following.back();
  if (first.following.size() + 1 == kMostSteps || first.dt != dt ||
      from[0].range()->data() != in.joint_q.range()->data() ||
      from[1].range()->data() != in.joint_qd.range()->data() || !same_inputs)
    return false;
  const StepOutputs to = {tensor_of(out.joint_q), tensor_of(out.joint_qd), tensor_of(out.body_q),
                          tensor_of(out.body_qd), tensor_of(scratch[0]),   tensor_of(scratch[1])};
  run_host(first, *first.host, &from, to);
  first.following.push_back(to);
  ++shared_->free_steps;
  return true;
}

void ArticulationStep::flush() {
  if (!pending_) return;
  const std::shared_ptr<const Step> step = std::exchange(pending_, nullptr);
  if (nova::Tape* tape = nova::Tape::active()) tape->record_custom(make_op(step));
}
void ArticulationStep::forget() { pending_ = nullptr; }

ContactBranches ArticulationStep::branches() const { return all_branches(*shared_); }
void ArticulationStep::clear_branches() {
  shared_->free_steps = 0;
  shared_->ended = nullptr;
  if (!shared_->trees) shared_->contacts.clear_branches();
  shared_->branches = {};
  shared_->motion = shared_->no_motion();
  shared_->far_steps = 0;
}
const MotionCounts* ArticulationStep::motion_counts() const {
  return shared_->contact_gradient == DerivativeOf::Code ? nullptr : &shared_->motion;
}
void ArticulationStep::count_from(int64_t number) { shared_->next_step = number; }

void ArticulationStep::check(const Model& model, const char* function) const {
  const OnHost<int32_t> status(shared_->status);
  check_contact_status({status.data(), status.size()}, function);
  shared_->contacts.check_adjoint(function);
  if (!shared_->trees) {
    const int64_t far = shared_->contacts.branches().unconverged;
    *std::exchange(shared_->far, std::make_shared<bool>(false)) =
        far > std::exchange(shared_->far_steps, far);
  }
  check_status(model, shared_->articulations, {status.data(), status.size()}, function);
}

}  // namespace novaphy::diff
