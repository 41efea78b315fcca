#include "novaphy/vbd/diff_vbd.h"

#include <algorithm>
#include <cstring>
#include <utility>

#include "diff_vbd_bodies.h"
#include "diff_vbd_step.h"
#include "element_arrays.h"
#include "novaphy/core/error.h"
#include "novaphy/dynamics/semi_implicit/diff_body_step.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff {
namespace {

using nova::Tensor;

// Returns the kernel that writes the row for the adaptive guess of the next step: the velocity, and
// the number 1.
const nova::Kernel& keep_velocity_kernel() {
  static const nova::Kernel kernel = nova::make_kernel(
      "vbd_keep_velocity", {{"particle_qd", nova::DType::F32, 3, nova::Access::Direct}},
      {{"last_velocity", 4}}, [](nova::TraceContext& c) {
        return std::vector{c.f32(0, 0), c.f32(0, 1), c.f32(0, 2), nova::Real(1.0f)};
      });
  return kernel;
}
void keep_velocity_as(const nova::Operand& qd, const Tensor& rows) {
  const nova::Operand to = rows.operand();
  keep_velocity_kernel().launch(qd.rows, qd, to);
}

}  // namespace

DiffSolverVBD::DiffSolverVBD(std::shared_ptr<const Model> model, const DiffVbdOptions& options)
    : DiffSolverBase(std::move(model)), options_(options) {
  const VbdOptions of_step = {.iterations = options.iterations,
                              .friction_epsilon = options.friction_epsilon,
                              .initial_guess = options.initial_guess,
                              .coarse = options.coarse,
                              .lhs_regularization = options.lhs_regularization};
  if (this->model()->body_count() > 0) {
    bodies_ = std::make_shared<DifferentiableBodies>(this->model(), of_step, options.gradient);
  } else {
    steps_ = std::make_shared<DifferentiableVbd>(this->model(), of_step, options.gradient);
  }
  if (looks_back())
    last_velocity_ =
        DeviceArray<Vec4f>(static_cast<size_t>(this->model()->particle_count()), device());
}

void DiffSolverVBD::reset() {
  const ExclusiveUse::Scope scope = use("DiffSolverVBD.reset");
  recorded_velocity_ = {};
  if (bodies_ != nullptr) bodies_->reset();
  if (last_velocity_.rows() == 0) return;
  const nova::NoGrad no_grad;
  if (nova::OpList* capture = nova::current_capture()) capture->uses(in_use());
  nova::submit_fill(last_velocity_.range(), 0.0f);
}

std::vector<ScratchSpec> DiffSolverVBD::step_scratch() const {
  if (!looks_back()) return {};
  return {{novaphy::DType::vec4, static_cast<size_t>(model()->particle_count()), 1}};
}

DeviceArray<Vec4f> DiffSolverVBD::new_velocities() const {
  const UntrackedScope untracked;
  return DeviceArray<Vec4f>(static_cast<size_t>(model()->particle_count()), device());
}

// Returns the previous velocity that the step reads. On a tape its memory stays unchanged until
// backward has read it.
Tensor DiffSolverVBD::last_velocity(StepInputs::Checkpoints* checkpoints) {
  if (!looks_back()) return {};
  const auto rows = static_cast<int64_t>(model()->particle_count());
  const auto tensor = [&](const Array& array) {
    return Tensor(array.range(), {rows, 4}, nova::DType::F32);
  };
  if (checkpoints != nullptr && checkpoints->is_recomputed)
    return tensor(checkpoints->kept.contains(checkpoints->step)
                      ? checkpoints->kept.at(checkpoints->step)
                      : checkpoints->kept.at(-1));
  const nova::Tape* const tape = nova::Tape::active();
  const bool is_recorded = tape != nullptr && recorded_velocity_.rows.defined() &&
                           recorded_velocity_.capture == nova::current_capture() &&
                           tape->carries_gradient(*recorded_velocity_.rows.range());
  const bool keep = checkpoints != nullptr && checkpoints->kept.empty();  // the first step
  Tensor last = is_recorded ? recorded_velocity_.rows : tensor(last_velocity_);
  if (!is_recorded && (tape != nullptr || keep)) {
    const nova::NoGrad no_grad;
    const DeviceArray<Vec4f> copy = new_velocities();
    nova::submit_copy(copy.range(), last.range());
    if (tape != nullptr) last = tensor(copy);
    if (keep) checkpoints->kept[checkpoints->step] = copy;
  } else if (keep) {
    checkpoints->kept[checkpoints->step] =
        Array(novaphy::DType::vec4, static_cast<size_t>(rows), 1, last.range());
  }
  return last;
}

// Stores the velocity of `in`, the state before the step, for the adaptive guess of the next step.
void DiffSolverVBD::keep_velocity(const SimState& in, StepInputs::Checkpoints* checkpoints,
                                  StepScratch scratch) {
  if (!looks_back()) return;
  const nova::Operand qd = nova::operand_of(in.particle_qd);
  const auto rows = static_cast<int64_t>(model()->particle_count());
  const auto keep = [&](const Array& to) {
    const Tensor tensor(to.range(), {rows, 4}, nova::DType::F32);
    keep_velocity_as(qd, tensor);
    return tensor;
  };
  if (checkpoints != nullptr && checkpoints->is_recomputed) {
    if (!checkpoints->kept.contains(-1)) checkpoints->kept[-1] = new_velocities();
    keep(checkpoints->kept.at(-1));
    return;
  }
  const bool is_kept = checkpoints != nullptr && checkpoints->next_is_kept;
  const nova::Tape* const tape = nova::Tape::active();
  if (tape != nullptr || is_kept) {
    const Array to = is_kept || scratch.empty() ? Array(new_velocities()) : scratch[0];
    const Tensor kept = keep(to);
    if (is_kept) checkpoints->kept[checkpoints->step + 1] = to;
    if (tape != nullptr) recorded_velocity_ = {nova::current_capture(), kept};
  }
  const nova::NoGrad no_grad;
  keep(last_velocity_);
}

namespace {

// `last`: of the last derivative of a step. Null `unsolved`: no step has a derivative.
GradientInfo info_of(GradientCounts counts, const VbdGradientInfo& last,
                     const UnsolvedSteps* unsolved, bool implicit) {
  if (implicit) {
    counts.residual = static_cast<float>(std::max(last.primal.relative, last.linear_residual));
    if (unsolved != nullptr && unsolved->count() > 0) {
      counts.residual = static_cast<float>(unsolved->largest());
      counts.surrogate_step = unsolved->first();
      for (int64_t k = 0; k < unsolved->count() && counts.exact + counts.frozen > 0; ++k) {
        --(counts.exact > 0 ? counts.exact : counts.frozen);
        ++counts.surrogate;
      }
    }
  }
  return novaphy::gradient_info(counts, implicit);
}

}  // namespace

struct DiffSolverVBD::Witness : GradientWitness {
  std::shared_ptr<const Model> model;
  std::shared_ptr<const DifferentiableVbd> steps;
  std::shared_ptr<const DifferentiableBodies> bodies;
  bool implicit;
  GradientNotes notes;
  std::shared_ptr<UnsolvedSteps> unsolved = std::make_shared<UnsolvedSteps>();
  int64_t step_count = 0;
  Witness(std::shared_ptr<const Model> m, std::shared_ptr<const DifferentiableVbd> s,
          std::shared_ptr<const DifferentiableBodies> b, bool i)
      : model(std::move(m)), steps(std::move(s)), bodies(std::move(b)), implicit(i) {}
  GradientInfo info() const override {
    return info_of(notes.counts(*model), steps ? steps->info() : bodies->info(), unsolved.get(),
                   implicit);
  }
  const char* without_record() const override {
    if (bodies != nullptr) return "DiffSolverVBD with bodies";
    if (!is_on_host(*model)) return "DiffSolverVBD on a device";
    const bool all_stored = !notes.chain().empty() || notes.counts(*model).steps == 0;
    return all_stored ? nullptr : "DiffSolverVBD with checkpoints";
  }
};

// Notes the step that number_of_step() counted.
StepReport DiffSolverVBD::note_step(NotedStep noted, bool keeps) {
  noted.slip = options_.friction_epsilon;
  const auto witness = witness_on_tape(witness_, [this] {
    return std::make_shared<Witness>(model(), steps_, bodies_, options_.gradient.implicit);
  });
  witness->notes.add_to_all(*model(), noted, keeps);
  notes_.add(*model(), std::move(noted), keeps);
  return {unsolved_, witness->unsolved, recorded_step_.number, witness->step_count++};
}

void DiffSolverVBD::clear_gradient_info() {
  notes_.clear();
  if (unsolved_ != nullptr) unsolved_ = std::make_shared<UnsolvedSteps>();
}

DiffVbdGradientInfo DiffSolverVBD::gradient_info() const {
  check_replays();
  const VbdGradientInfo of = last_info();
  return {info_of(notes_.counts(*model()), of, unsolved_.get(), options_.gradient.implicit),
          of.primal,
          of.linear_residual,
          of.linear_sweeps,
          of.converged,
          of.halvings};
}

// A replay cannot throw, and writes NaN instead. This check later throws the reason.
void DiffSolverVBD::check_replays() const {
  if (failure_->empty()) return;
  fail(ErrorKind::Runtime,
       "DiffSolverVBD: a replay of a captured step failed, its results are NaN: ",
       std::exchange(*failure_, {}));
}

// Returns a copy of the contacts, because the pipeline may overwrite the original before backward
// reads it. If the contacts did not change, the steps share one copy.
std::shared_ptr<const Contacts> DiffSolverVBD::kept(const Contacts* contacts) {
  if (contacts == nullptr) return nullptr;
  const auto same = [](const Array& a, const Array& b) {
    return a.bytes() == b.bytes() &&
           (a.bytes() == 0 || std::memcmp(a.raw(), b.raw(), a.bytes()) == 0);
  };
  const Contacts* last = last_contacts_.get();
  if (last == nullptr || !same(last->soft_contact_count, contacts->soft_contact_count) ||
      !same(last->soft_contact_particle, contacts->soft_contact_particle) ||
      !same(last->soft_contact_shape, contacts->soft_contact_shape) ||
      !same(last->soft_contact_body_pos, contacts->soft_contact_body_pos) ||
      !same(last->soft_contact_body_vel, contacts->soft_contact_body_vel) ||
      !same(last->soft_contact_normal, contacts->soft_contact_normal))
    last_contacts_ = std::make_shared<const Contacts>(contacts->clone());
  return last_contacts_;
}

void DiffSolverVBD::step(SimState& state_in, SimState& state_out, const Control* control,
                         const Contacts* contacts, float dt, const DeviceArray<Vec3f>* targets) {
  if (&state_in == &state_out) {
    step(state_in, next_state(RecordedStep::kName), control, contacts, dt, targets);
    return take_next(state_in);
  }
  check_replays();
  const ExclusiveUse::Scope scope = use(RecordedStep::kName);
  check_step(RecordedStep::kName, state_in, state_out, control, contacts, dt);
  const auto kinematic = static_cast<size_t>(kinematic_count());
  require(targets == nullptr || (targets->rows() == kinematic && targets->device() == device()),
          ErrorKind::Value, RecordedStep::kName, ": targets: expected {", kinematic,
          ", 3}, a position for every kinematic particle, got ",
          targets == nullptr ? 0 : targets->rows(), " rows");
  begin();
  if (nova::Tape::active() != nullptr) make_leaves(state_in);
  StepInputs inputs;
  inputs.control = control;
  inputs.contacts = contacts;
  inputs.forces = nova::operand_of(state_in.particle_f);
  inputs.body_forces = nova::operand_of(state_in.body_f);
  if (targets != nullptr && kinematic != 0) inputs.targets = nova::operand_of(*targets);
  inputs.dt = dt;
  record_step(state_in, state_out, inputs, {});
}

// In a capture on the CPU, registers the values that a replay depends on. If a value has changed,
// the replay throws before it begins, instead of writing NaN.
void DiffSolverVBD::begin() {
  if (nova::current_capture() == nullptr || !device().is_cpu()) return;
  model()->depend_on_numbers();
  values_.check(*model());
}

bool DiffSolverVBD::begin_rollout(const RolloutInputs&) {
  check_replays();
  begin();
  return model()->particle_count() > 0 || bodies_ != nullptr;
}

// Returns the index of a step in its chain of recorded steps.
int64_t DiffSolverVBD::number_of_step(const void* start, const void* end) {
  const bool follows = recorded_step_.end == start;
  recorded_step_ = {end, follows ? recorded_step_.number + 1 : 0};
  if (recorded_step_.number == 0) unsolved_ = std::make_shared<UnsolvedSteps>();
  return recorded_step_.number;
}

namespace {

NotedStep noted_step(const RecordedStep& step, const SimState& in, const SimState& out) {
  NotedStep noted;
  noted.start = in.particle_q.range()->data();
  noted.end = out.particle_q.range()->data();
  noted.q = out.particle_q;
  noted.qd = out.particle_qd;
  noted.contacts = step.contacts;
  noted.soft = true;
  return noted;
}

}  // namespace

void DiffSolverVBD::record_step(const SimState& in, SimState& out, const StepInputs& inputs,
                                StepScratch scratch) {
  if (bodies_ != nullptr) return record_bodies(in, out, inputs);
  const Model& m = *model();
  nova::Tape* const tape = nova::Tape::active();
  auto step = std::make_shared<RecordedStep>(model());
  step->steps = steps_;
  step->failure = failure_;
  step->in_use = in_use();
  const bool captured = nova::current_capture() != nullptr, on_device = step->on_device();
  if (on_device && tape == nullptr) {  // no backward pass will read the contacts
    step->contacts = {std::shared_ptr<void>(), inputs.contacts};
  } else if ((captured || on_device) && inputs.contacts != nullptr) {
    const nova::NoGrad no_grad;  // every replay of a capture makes this copy
    step->contacts = std::make_shared<const Contacts>(inputs.contacts->clone());
  } else {
    step->contacts = kept(inputs.contacts);
  }
  step->q = tensor_of(nova::operand_of(in.particle_q));
  step->qd = tensor_of(nova::operand_of(in.particle_qd));
  step->f = tensor_of(inputs.forces);
  step->target_count = static_cast<size_t>(kinematic_count());
  if (inputs.targets.range != nullptr) {
    step->targets = tensor_of(inputs.targets);
    step->first_target = inputs.first_target;
  }
  step->activations = vbd::activations_of(inputs.control, m);
  step->last = last_velocity(inputs.checkpoints.get());
  step->q_out = out.particle_q;
  step->qd_out = out.particle_qd;
  step->dt = inputs.dt;
  step->of_rollout = inputs.step;
  step->implicit = options_.gradient.implicit;
  if (tape != nullptr) {
    step->check_others(*tape, inputs.contacts);
    step->trains_elements = step->trains(*tape);
  }
  if (captured) nova::current_capture()->uses(in_use());
  RecordedStep::submit_forward(step);
  if (tape == nullptr) return keep_velocity(in, inputs.checkpoints.get(), scratch);
  step->number = number_of_step(in.particle_q.range()->data(), out.particle_q.range()->data());
  step->report = note_step(noted_step(*step, in, out), inputs.checkpoints == nullptr);
  nova::CustomOp op;
  op.name = "vbd_step";
  for (const RecordedStep::Input& input : step->differentiable()) op.inputs.push_back(input.tensor);
  op.outputs = {tensor_of(nova::operand_of(out.particle_q)),
                tensor_of(nova::operand_of(out.particle_qd))};
  op.reads = op.inputs;
  op.reads.push_back(Tensor::view(m.particle_inv_mass));
  op.vjp = [step](std::span<const Tensor> outputs, std::span<const nova::InputGradient> to) {
    RecordedStep::submit_backward(step, outputs, to);
  };
  op.jvp = [step](std::span<const Tensor> tangents, std::span<const Tensor> outputs) {
    RecordedStep::submit_tangent(step, tangents, outputs);
  };
  op.forward = [step] { RecordedStep::submit_forward(step); };
  op.submits_only = captured || (on_device && !step->implicit);
  tape->record_custom(std::move(op));
  keep_velocity(in, inputs.checkpoints.get(), scratch);
}

}  // namespace novaphy::diff
