#include "novaphy/dynamics/diff_solver_base.h"

#include <algorithm>
#include <initializer_list>

#include "novaphy/core/parallel.h"
#include "novaphy/core/sim/named_step.h"
#include "novaphy/dynamics/diff_operators.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff {

using nova::Access;
using nova::DType;
using nova::Operand;
using nova::Tensor;

namespace {

const nova::Kernel& add_kernel() {
  static const nova::Kernel kernel = nova::with_one_gradient_set(nova::make_kernel(
      "apply_forces",
      {{"particle_f", DType::F32, 3, Access::Direct}, {"forces", DType::F32, 3, Access::Direct}},
      {{"sum", 3}}, [](nova::TraceContext& c) {
        return std::vector{c.f32(0, 0) + c.f32(1, 0), c.f32(0, 1) + c.f32(1, 1),
                           c.f32(0, 2) + c.f32(1, 2)};
      }));
  return kernel;
}

// Computes sum = a + b, row by row. Without an active tape, `sum` may be `a` or `b`.
void add(const Operand& a, const Operand& b, const Operand& sum) {
  const Operand in[] = {a, b};
  add_kernel().launch(sum.rows, in, sum);
}

// Returns `rows` rows of an operand, from row `first` on, as an operand.
Operand rows_of(const Operand& all, size_t first, int64_t rows) {
  const size_t row = static_cast<size_t>(all.width) * sizeof(float);
  Operand part = all;
  part.rows = rows;
  part.range = all.range->storage().range(all.range->offset() + first * row,
                                          static_cast<size_t>(rows) * row);
  return part;
}

Tensor tensor_of(const Operand& operand) {
  return {operand.range, {operand.rows, operand.width}, DType::F32};
}

// The gradient by `forces` covers the whole array, so the adjoint of a step adds to its own rows
// only.
nova::CustomOp add_forces_op(const Operand& f, const Operand& forces, size_t first_row,
                             const Operand& sum) {
  const int64_t rows = sum.rows;
  return {.name = "apply_forces_of_step",
          .inputs = {tensor_of(f), tensor_of(forces)},
          .outputs = {tensor_of(sum)},
          .vjp =
              [=](std::span<const Tensor> g, std::span<const nova::InputGradient> gradients) {
                if (gradients[0].wanted()) gradients[0].put(g[0]);
                if (!gradients[1].wanted()) return;
                const Operand all = gradients[1].grad.operand();
                if (!gradients[1].add) nova::submit_fill(all.range, 0.0f);
                const Operand mine = rows_of(all, first_row, rows);
                add(mine, g[0].operand(), mine);
              },
          .forward = [=] { add(f, rows_of(forces, first_row, rows), sum); },
          .jvp =
              [=](std::span<const Tensor> t, std::span<const Tensor> tangents) {
                const Operand to = tangents[0].operand();
                if (t[0].defined()) {
                  nova::submit_copy(to.range, t[0].range());
                } else {
                  nova::submit_fill(to.range, 0.0f);
                }
                if (t[1].defined()) add(to, rows_of(t[1].operand(), first_row, rows), to);
              }};
}

}  // namespace

void detail::add_forces(Operand applied, Operand forces, size_t first_row, Operand sum) {
  constexpr int32_t kWidth = 3;  // width of the kernel: a wrench fills two rows
  first_row *= static_cast<size_t>(sum.width / kWidth);
  for (Operand* o : {&applied, &forces, &sum}) {
    o->rows *= o->width / kWidth;
    o->width = kWidth;
  }
  nova::Tape* tape = nova::Tape::active();
  if (forces.rows == sum.rows) return add(applied, forces, sum);
  if (!tape || !tape->must_record({&forces, 1}))
    return add(applied, rows_of(forces, first_row, sum.rows), sum);
  const nova::CustomOp op = add_forces_op(applied, forces, first_row, sum);
  {
    const nova::NoGrad no_grad;
    op.forward();
  }
  tape->record_custom(op);
}

void detail::add_solver_kernels(std::vector<nova::EngineKernel>& list) {
  list.push_back({add_kernel(), add_kernel().gradients()});
}

void make_leaves(const SimState& state) {
  if (!state.requires_grad) return;
  for (const Array* array : std::initializer_list<const Array*>{
           &state.particle_q, &state.particle_qd, &state.body_q, &state.body_qd, &state.joint_q,
           &state.joint_qd, &state.act})
    if (array->rows() != 0) nova::grad_info(*array->range()).requires_grad = true;
}

namespace {

// The external forces of a rollout on its particles or on its bodies.
struct AppliedForces {
  RolloutInputs::Forces forces;
  Operand applied, more;  // the sum, and the part that acts in every step
  size_t scratch = 0;     // scratch memory for the sum of a step, if the forces change over the
                          // steps

  AppliedForces(const Array& of_trajectory, const RolloutInputs::Forces& given)
      : forces(given), applied(nova::operand_of(of_trajectory)) {
    if (!forces.any()) return;
    more = nova::operand_of(forces.rows);
    if (forces.change) return;
    const Operand sum = nova::operand_of(
        Array(of_trajectory.dtype(), of_trajectory.rows(), of_trajectory.device()));
    detail::add_forces(applied, more, 0, sum);
    applied = sum;
  }
  bool change() const { return forces.any() && forces.change; }
  void want_scratch(std::vector<ScratchSpec>& specs) {
    scratch = specs.size();
    if (change()) specs.push_back({forces.rows.dtype(), forces.count, 1});
  }
  Operand of_step(int32_t t, StepScratch arrays) const {
    if (!change()) return applied;
    const Operand sum = nova::operand_of(arrays[scratch]);
    detail::add_forces(applied, more, forces.first(t), sum);
    return sum;
  }
};

// The contacts that a pipeline finds in one step.
struct FoundContacts {
  Contacts contacts;
  ContactTables tables;
};

}  // namespace

void DiffSolverBase::rollout(Trajectory& trajectory, const Control* control,
                             const Contacts* contacts, float dt, const RolloutOptions& options) {
  const RolloutInputs inputs(*model(), trajectory, control, contacts, dt, options, target_count());
  const ExclusiveUse::Scope scope = use("rollout");
  if (inputs.steps() == 0 || !begin_rollout(inputs)) return;
  if (inputs.contacts() != nullptr) watch_overflow("rollout", *inputs.contacts());
  const bool recording = nova::Tape::active() != nullptr;
  if (recording) make_leaves(trajectory.any_state(inputs.start()));
  constexpr int32_t kStepsPerInterruptCheck = 32;
  // Deferred steps run one block of particles after the other, so that a block stays in the cache.
  constexpr int32_t kLargeParticleCount = 2048;
  nova::DeferredScope deferred(only_submits() && model()->particle_count() >= kLargeParticleCount);
  AppliedForces on_particles(trajectory.fields().particle_f, inputs.forces()),
      on_bodies(trajectory.fields().body_f, inputs.body_forces());
  std::vector<ScratchSpec> specs = step_scratch();
  const size_t own = specs.size();
  on_particles.want_scratch(specs);
  on_bodies.want_scratch(specs);
  const auto alone = make_scratch(specs, 1, device());
  if (recording) trajectory.reserve_scratch(specs);

  // Each step that the tape stores has its own contacts. All other steps share the first entry.
  const int32_t interval = trajectory.checkpoint_interval();
  const auto found = std::make_shared<std::vector<FoundContacts>>();
  if (inputs.pipeline() != nullptr) {
    // A capture must not record the allocation of new memory.
    const UntrackedScope untracked;
    const int32_t remembered = !recording ? 0 : interval == 1 ? inputs.steps() : interval;
    for (int32_t k = 0; k <= remembered; ++k) found->push_back({inputs.pipeline()->contacts(), {}});
  }
  const auto slot = [recording, interval, start = inputs.start()](int32_t t) {
    return static_cast<size_t>(!recording ? 0 : 1 + (interval == 1 ? t - start : t % interval));
  };
  const auto checkpoints = interval > 1 ? std::make_shared<StepInputs::Checkpoints>() : nullptr;
  const auto step = [this, inputs, own, on_particles, on_bodies, found, checkpoints](
                        int32_t t, const SimState& from, SimState& to, StepScratch scratch,
                        size_t contact_slot) {
    StepInputs now{.control = inputs.control(t),
                   .contacts = inputs.contacts(),
                   .forces = on_particles.of_step(t, scratch),
                   .body_forces = on_bodies.of_step(t, scratch),
                   .targets = {},
                   .dt = inputs.dt(),
                   .step = t,
                   .checkpoints = checkpoints};
    now.is_first = t == inputs.start();
    if (inputs.targets().any()) {
      now.targets = nova::operand_of(inputs.targets().rows);
      now.first_target = inputs.targets().first(t);
    }
    if (!found->empty()) {
      FoundContacts& here = (*found)[contact_slot];
      inputs.pipeline()->collide(from, here.contacts, {}, inputs.dt());
      watch_overflow("rollout", here.contacts);
      now.contacts = &here.contacts;
      now.tables = &here.tables;
    }
    named_step(t, [&] { record_step(from, to, now, scratch.first(own)); });
  };
  const std::shared_ptr<ExclusiveUse> later = step_writes_kept_memory() ? in_use() : nullptr;
  if (nova::OpList* graph = nova::current_capture(); graph != nullptr && later != nullptr)
    graph->uses(later);
  for (int32_t first = inputs.start(); first < inputs.stop(); first += interval) {
    const nova::RecomputedScope once_more(interval > 1, later);
    for (int32_t t = first; t < std::min(first + interval, inputs.stop()); ++t) {
      if (t % kStepsPerInterruptCheck == 0) check_interrupt();
      if (checkpoints != nullptr) {
        checkpoints->step = t;
        checkpoints->next_is_kept = trajectory.keeps(t + 1);
      }
      const nova::Tape::StepScope of_step(t);
      step(t, trajectory.any_state(t), trajectory.any_state(t + 1),
           recording ? trajectory.scratch(t) : StepScratch(alone[0]), slot(t));
    }
  }
  deferred.flush();
  trajectory.set_last_rollout(
      inputs.start(), inputs.stop(),
      [this, step, alone, checkpoints](int32_t t, const SimState& from, SimState& to) {
        const ExclusiveUse::Scope again = use("Trajectory.recompute");
        const nova::NoGrad no_grad;
        if (checkpoints != nullptr) {
          checkpoints->step = t;
          checkpoints->is_recomputed = true;
        }
        step(t, from, to, alone[0], 0);
      });
}

}  // namespace novaphy::diff
