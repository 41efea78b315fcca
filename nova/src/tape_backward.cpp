// Tape::backward first plans the operations of the backward pass, and checks every value that they
// will read. Then the operations run. An overwritten input is therefore reported before a gradient changes.
#include <algorithm>
#include <array>
#include <utility>

#include "adjoint_launch.h"
#include "engine_kernels.h"
#include "novaphy/core/error.h"
#include "novaphy/core/parallel.h"
#include "novaphy/nova/op_list.h"
#include "tape_impl.h"

namespace nova {

using detail::AdjointKey;
using detail::Words;
using novaphy::Range;
using novaphy::require;
using novaphy::Storage;

namespace {

const Kernel& accumulate_kernel() {
  static const Kernel kernel =
      make_kernel("accumulate_gradient",
                  {{"a", DType::F32, 1, Access::Direct}, {"b", DType::F32, 1, Access::Direct}},
                  {{"sum", 1}}, [](TraceContext& c) { return std::vector{c.f32(0) + c.f32(1)}; });
  return kernel;
}

void fill_zero_now(Range& range) {
  const novaphy::DeviceContext& c = novaphy::device_context(range.storage().device());
  novaphy_error error = novaphy::make_error();
  novaphy::check(c.api->memory_fill(c.stream, range.data(), 0, 4, range.bytes(), &error), error,
                 "fill");
}

uint64_t bit(uint32_t k) { return uint64_t{1} << k; }

// Returns whether the adjoint stores the gradient of a source at its own row. Gradients of other
// sources are row sums with all columns.
bool is_stored_at_its_row(Access access) {
  return access == Access::Direct || access == Access::CsrRow;
}

}  // namespace

void detail::accumulate(const Operand& into, const Operand& from) {
  auto flat = [](Operand o) {
    o.rows *= o.width;
    o.width = 1;
    return o;
  };
  const Operand in[] = {flat(into), flat(from)};
  accumulate_kernel().launch(in[0].rows, in, {&in[0], 1});
}

void detail::add_tape_kernels(EngineKernels& list) { list.push_back({accumulate_kernel(), {}}); }

// Returns whether an earlier input of the operation is the same range and carries a gradient.
bool Tape::Impl::bound_before(const Op& op, uint32_t s) const {
  for (uint32_t other = 0; other < s; ++other)
    if (input(op, other).carries && input(op, other).operand.range == input(op, s).operand.range)
      return true;
  return false;
}

// Returns whether the next contribution adds to the range's gradient; otherwise it stores.
bool Tape::Impl::begin_contribution(Node& n) {
  if (n.set) return true;
  n.set = true;
  if (outer) return begin_in_body(n);
  GradInfo& info = grad_info(*n.range);
  OpList* graph = current_capture();
  const bool leaf = !n.ever_written;
  const bool kept = leaf || !leaves_only;
  n.place = kept ? &grad_storage(*n.range) : pool.take(*n.range);
  if (leaf && graph && info.state != GradState::Held && info.zeroed_in_capture != graph->id()) {
    // Every replay adds to the gradient in memory, so the memory needs zeros for the first replay.
    fill_zero_now(*info.grad);
    info.state = GradState::Held;
  }
  const bool add = leaf && info.state == GradState::Held;  // only leaves accumulate over calls
  info.state = kept ? GradState::Held : GradState::Dropped;
  if (graph) graph->gradient(n.range, info.state);
  return add;
}

// Checks that the rows of a CSR sum are unchanged. The items Program also needs the unchanged table
// from which the rows were built.
void Tape::Impl::check_csr(const Op& op, std::initializer_list<CsrUse> needed) {
  for (const CsrUse which : needed) {
    const Use& use = csr_use(op, which);
    const bool never = use.version == kOutdated;
    if (use.producer >= 0 && !never ? overwritten_in_group(use) : never || was_modified(use))
      novaphy::fail(ErrorKind::Runtime, "the index table of op '", op_name(op),
                    which == kTable
                        ? "' was modified after recording"
                        : "' was rebuilt after recording; its adjoint needs the rows as "
                          "they were: give each step an Incidence of its own, or rebuild "
                          "it in the step between two checkpoints");
  }
}

// Checks that a value that an adjoint reads equals the recorded value, or will equal it after its
// group is recomputed.
void Tape::Impl::check_needed(const Use& use, const Op& op, uint32_t input) {
  if (use.producer < 0) {
    check_value(use, op, input);
  } else if (overwritten_in_group(use)) {
    novaphy::fail(ErrorKind::Runtime, "input '", input_name(op, input), "' of op '", op_name(op),
                  "' was overwritten before the next checkpoint; its adjoint would read the later "
                  "value: give each step memory of its own, or make a checkpoint of each step");
  }
}

void Tape::Impl::check_needed(const Op& op, const detail::CompiledPlan& plan) {
  for (uint32_t s = 0; s < op.inputs; ++s) {
    if (!plan.plan.loads_value[s]) continue;
    const Use& use = input(op, s);
    if (use.producer >= 0 || was_modified(use)) check_needed(use, op, s);
  }
  if (op.has_active) check_needed(active_use(op), op, op.inputs);
  if (!op.csr) return;
  if (plan.items) check_csr(op, {kTable});
  if (plan.rows && !plan.rows->program.loops.empty()) check_csr(op, {kOffsets, kItems});
}

// Checks a group. The group is recomputed before the first of its adjoints, so its inputs from
// outside must be unchanged.
void Tape::Impl::check_group(const Group& group) {
  for (uint32_t k = group.first; k < group.last; ++k) {
    if (!ops[k].replayed) continue;
    for (uint32_t s = 0; s < ops[k].inputs; ++s)
      if (input(ops[k], s).producer < 0) check_value(input(ops[k], s), ops[k], s);
    if (ops[k].has_active && active_use(ops[k]).producer < 0)
      check_value(active_use(ops[k]), ops[k], ops[k].inputs);
    if (!ops[k].csr || !ops[k].kernel) continue;
    for (const CsrUse which : {kOffsets, kItems})
      if (csr_use(ops[k], which).producer < 0) check_csr(ops[k], {which});
  }
}

void Tape::Impl::plan_group(int32_t number) {
  check_group(groups[static_cast<size_t>(number)]);
  Step step{};
  step.group = number;
  steps.push_back(step);
}

void Tape::Impl::run_again(const Op& op, DeferredScope& deferred) {
  if (op.custom >= 0) return run_custom_forward(customs[static_cast<size_t>(op.custom)], deferred);
  if (op.csr) return rebuild(op.csr);
  const HandWritten& h = hand_written[static_cast<size_t>(op.hand_written)];
  submit_launch(*h.context, h.kernel, h.name, h.n, h.words, nullptr, h.accesses);
  for (uint32_t u = 0; u < op.inputs + op.outputs; ++u) {
    const std::shared_ptr<Range>& range = uses[op.first_use + u].operand.range;
    hold_in_capture(range);
    if (u >= op.inputs) note_write(range);
  }
}

// Returns the last writes of a group whose values were not overwritten after the group.
std::vector<const Tape::Impl::Use*> Tape::Impl::last_written(const Group& group) const {
  std::vector<const Use*> found;
  for (uint32_t k = group.first; k < group.last; ++k) {
    const Op& op = ops[k];
    for (uint32_t o = 0; op.replayed && o < op.outputs; ++o) {
      const Use& use = uses[op.first_use + op.inputs + o];
      if (version_of(*use.operand.range) == use.version) found.push_back(&use);
    }
  }
  return found;
}

void Tape::Impl::run_group(const Group& group, DeferredScope& deferred) {
  const std::vector<const Use*> same = last_written(group);
  for (uint32_t k = group.first; k < group.last; ++k) {
    const Op& op = ops[k];
    if (!op.replayed) continue;
    if (!op.kernel) {
      run_again(op, deferred);
      continue;
    }
    operands.clear();
    for (uint32_t u = 0; u < op.inputs + op.outputs; ++u)
      operands.push_back(uses[op.first_use + u].operand);
    const std::span<const Operand> all = operands;
    detail::run_forward(*op.kernel, op.dim, all.first(op.inputs), all.subspan(op.inputs),
                        std::span(params).subspan(op.first_param, op.params), op.csr.get(),
                        op.extent, active(op));
    hold_in_capture(op.kernel);
    if (op.csr) hold_in_capture(op.csr);
    for (const Operand& operand : all) hold_in_capture(operand.range);
  }
  operands.clear();
  for (const Use* use : same) {
    const Range& range = *use->operand.range;
    written_again[&range] = {use->version, range.version()};
    if (GradInfo* info = find_grad_info(range); info && info->last_tape == this)
      info->recorded_version = range.version();
  }
}

// Returns a source of operation k - 1, or -1: the index table through which operation k sums the
// output of k - 1. The adjoint of k - 1 can then read the gradient of the sums through the table
// (AdjointMask::table). Only a tape that keeps all gradients needs the gradient of the terms.
int32_t Tape::Impl::summed_through(size_t k, uint32_t s) {
  const Op& sum = ops[k];
  if (k == 0 || !sum.kernel || !sum.csr || sum.kernel->summed_source != static_cast<int32_t>(s))
    return -1;
  for (uint32_t other = 0; other < sum.inputs; ++other)
    if (other != s && input(sum, other).operand.range == input(sum, s).operand.range) return -1;
  const Op& giver = ops[k - 1];
  if (!giver.kernel || giver.constant || giver.outputs != 1 || giver.group != sum.group) return -1;
  const Operand& terms = output(giver, 0);
  if (input(sum, s).operand.range != terms.range || find(*terms.range)->set) return -1;
  const Operand& table = sum.csr->table;
  for (uint32_t t = 0; t < giver.inputs; ++t)
    // the gradients of this input and of the sums would share memory
    if (input(giver, t).operand.range == output(sum, 0).range) return -1;
  for (uint32_t t = 0; t < giver.inputs; ++t) {
    const Operand& in = input(giver, t).operand;
    const bool same = in.range == table.range && in.rows * in.width == table.rows &&
                      giver.kernel->sources[t].access == Access::Direct;
    if (same && in.rows == giver.dim && terms.width == in.width * output(sum, 0).width)
      return static_cast<int32_t>(t);
  }
  return -1;
}

// Returns, as bits, the columns of an input's gradient that the adjoint of the last operation that
// wrote the input does not read. Only valid for a tape that keeps only the gradients of leaves.
uint32_t Tape::Impl::unread_columns(size_t k, const Operand& in) {
  const Range* range = in.range.get();
  while (k-- > 0) {
    // In most cases the last writer of the range came before k, and the search can jump to it.
    if (const int32_t writer = find(*range)->writer; writer < static_cast<int32_t>(k)) {
      if (writer < 0) return 0;
      k = static_cast<size_t>(writer);
    }
    const Op& op = ops[k];
    for (uint32_t o = 0; o < op.outputs; ++o) {
      const Operand& out = output(op, o);
      if (out.range.get() != range) continue;
      if (!op.kernel || op.constant || out.rows * out.width != in.rows * in.width) return 0;
      if (op.kernel->is_copy) {  // a copy passes its gradient on
        range = input(op, 0).operand.range.get();
        break;
      }
      if (out.width != in.width) return 0;
      uint64_t wrt = 0;
      for (uint32_t s = 0; s < op.inputs; ++s) wrt |= input(op, s).carries ? bit(s) : 0;
      return op.kernel->unread_columns(o, wrt);
    }
  }
  return 0;
}

void Tape::Impl::plan_steps() {
  steps.clear();
  places.clear();
  int32_t open_group = -1;
  // For the operation that the next iteration handles, see summed_through: the index table, the
  // number of rows of the sums, and the memory of their gradient.
  int32_t table = -1;
  int64_t sums = 0;
  const std::shared_ptr<Range>* of_sums = nullptr;
  for (size_t k = ops.size(); k-- > 0;) {
    const Op& op = ops[k];
    if (op.constant) continue;
    AdjointKey key;
    key.table = std::exchange(table, -1);
    const int64_t gradient_rows = key.table < 0 ? op.dim : sums;
    const size_t first_place = places.size();
    places.resize(first_place + op.outputs + op.inputs);
    const auto output_places = places.begin() + static_cast<ptrdiff_t>(first_place);
    const auto input_places = output_places + op.outputs;
    for (uint32_t o = 0; o < op.outputs; ++o) {
      Node& n = *find(*output(op, o).range);
      if (!n.set) continue;
      key.seeded |= uint32_t{1} << o;
      output_places[o] = key.table < 0 ? n.place : of_sums;
      n.set = false;  // an earlier value of the same range begins without a gradient
    }
    if (!key.seeded) {
      places.resize(first_place);
      continue;
    }
    if (op.group >= 0 && op.group != open_group) plan_group(op.group);
    open_group = op.group;
    for (uint32_t s = 0; s < op.inputs; ++s) {
      const Use& use = input(op, s);
      if (!use.carries) continue;
      Node& n = *find(*use.operand.range);
      if (const int32_t through = summed_through(k, s); through >= 0) {
        check_csr(op, {kTable});
        table = through;
        sums = op.dim;
        of_sums = output_places[0];
        if (leaves_only) {
          n.set = true;
          n.unread = 0;
          n.place = of_sums;
          grad_info(*n.range).state = GradState::Dropped;
          if (OpList* graph = current_capture()) graph->gradient(n.range, GradState::Dropped);
          continue;
        }
      }
      key.wrt |= bit(s);
      if (bound_before(op, s)) {  // this gradient is computed separately and added afterwards
        input_places[s] = n.place;
        continue;
      }
      if (!n.set) n.read_version = use.version;
      if (!n.ever_written && n.read_version != use.version)
        novaphy::fail(ErrorKind::Runtime, "input '", input_name(op, s), "' of op '", op_name(op),
                      "' was modified after recording: a later operation read other values of it, "
                      "and one gradient "
                      "cannot be of both");
      if (!n.set) {
        n.unread = leaves_only && n.ever_written ? unread_columns(k, use.operand) : 0;
        n.unread_width = use.operand.width;
      }
      if (begin_contribution(n)) key.accumulate |= bit(s);
      input_places[s] = n.place;
      if (n.unread != 0 && op.kernel && key.narrowed < 0 && n.unread_width == use.operand.width &&
          is_stored_at_its_row(op.kernel->sources[s].access)) {
        key.narrowed = static_cast<int32_t>(s);
        key.unread = n.unread;
      }
    }
    if (leaves_only && table < 0)
      for (uint32_t o = 0; o < op.outputs; ++o)
        if (output_places[o]) pool.give_back(output_places[o]);
    if (op.kernel && key.wrt == 0) {
      places.resize(first_place);
      continue;
    }
    const detail::CompiledPlan* plan = nullptr;
    if (op.kernel) {
      plan = &op.kernel->declared_adjoint(key);
      check_needed(op, *plan);
    } else {
      check_read_values(op);
    }
    steps.push_back({&op, key, plan, first_place, gradient_rows});
  }
}

void Tape::Impl::backward(Node& loss, const Tensor& seed) {
  before.clear();
  values.clear();
  present.clear();
  for (Node& n : nodes) {
    GradInfo& info = grad_info(*n.range);
    before.push_back(info.state);
    n.set = false;
    n.unread = 0;
    if (n.ever_written) info.state = GradState::Zero;
  }
  Copies kept;  // copies of gradients before the call
  bool running = false;
  try {
    begin_contribution(loss);
    const std::shared_ptr<Range>* loss_gradient = loss.place;
    plan_steps();
    size_t k = 0;
    for (Node& n : nodes) {
      if (before[k++] != GradState::Held || n.ever_written || !n.set || current_capture()) continue;
      const std::shared_ptr<Range>& grad = grad_storage(*n.range);
      kept.emplace_back(grad,
                        Storage::allocate(grad->bytes(), grad->storage().device(), false)->range());
      submit_copy(kept.back().second, grad);
    }
    running = true;
    run_steps(*loss_gradient, seed);
    if (!current_capture()) report_not_finite(*loss_gradient, seed, kept);
  } catch (...) {  // A call that fails restores the gradients of leaves.
    size_t k = 0;
    for (Node& n : nodes) {
      const GradState state = before[k++];
      grad_info(*n.range).state = running && n.ever_written ? GradState::Zero : state;
    }
    for (const auto& [grad, copy] : kept) submit_copy(grad, copy);
    pool.clear();
    scratch.clear();
    throw;
  }
  pool.clear();
  scratch.clear();
}

void Tape::Impl::run_steps(const std::shared_ptr<Range>& loss_gradient, const Tensor& seed,
                           const std::function<bool(const Step&)>& stop) {
  std::vector<novaphy::ExclusiveUse::Scope> memory;
  if (OpList* graph = current_capture()) {
    for (const auto& use : group_memory.all()) graph->uses(use);
  } else {
    memory = group_memory.take("backward", "the solver of the rollout");
  }
  if (seed.defined()) {
    submit_copy(loss_gradient, seed.range());
  } else if (loss_gradient) {
    submit_fill(loss_gradient, 1.0f);
  }
  // Operations over many rows are collected and run block by block, as long as the memory that this
  // keeps alive is small.
  int64_t largest = 0;
  for (const Step& step : steps)
    if (step.op) largest = std::max(largest, step.op->dim);
  DeferredScope deferred(!stop && largest >= detail::PlanLimits{}.min_rows);
  constexpr size_t kStepsPerInterruptCheck = 64, kMaxHeldBytes = size_t{64} << 20;
  for (size_t k = 0; k < steps.size(); ++k) {
    if (k % kStepsPerInterruptCheck == 0) novaphy::check_interrupt();
    if (!steps[k].op) {
      run_group(groups[static_cast<size_t>(steps[k].group)], deferred);
    } else if (steps[k].op->kernel) {
      run_kernel(steps[k]);
      if (deferred.held_bytes() > kMaxHeldBytes) deferred.flush();
    } else {
      run_custom(steps[k], deferred);
      if (deferred.held_bytes() > kMaxHeldBytes) deferred.flush();
    }
    if (stop && stop(steps[k])) return;
  }
  deferred.flush();
}

void Tape::Impl::run_kernel(const Step& step) {
  const Op& op = *step.op;
  constexpr size_t kMaxSources = 64;
  // The memory of each source's gradient. If a range is bound to two sources, the first
  // contribution is stored, and the second is added afterwards.
  std::array<const std::shared_ptr<Range>*, kMaxSources> gradients;
  std::vector<std::pair<uint32_t, Operand>> added_later;
  for (uint32_t s = 0; s < op.inputs; ++s) {
    gradients[s] = nullptr;
    if (!(step.key.wrt & bit(s))) continue;
    const Operand& in = input(op, s).operand;
    gradients[s] = input_gradient(step, s);
    if (bound_before(op, s)) {
      added_later.reserve(op.inputs);  // keeps pointers to the elements valid
      added_later.push_back(
          {s, detail::temporary(in.rows, in.width, in.range->storage().device())});
      gradients[s] = &added_later.back().second.range;
    }
  }
  constexpr size_t kMaxOutputs = 32;
  std::array<const std::shared_ptr<Range>*, kMaxOutputs> output_gradients;
  for (uint32_t o = 0; o < op.outputs; ++o) output_gradients[o] = output_gradient(step, o);
  std::array<const Operand*, kMaxSources> inputs;
  for (uint32_t s = 0; s < op.inputs; ++s) inputs[s] = &input(op, s).operand;
  detail::run_adjoint(*op.kernel, *step.plan,
                      {.dim = op.dim,
                       .wanted = step.key,
                       .inputs = std::span(inputs.data(), op.inputs),
                       .input_gradients = std::span(gradients.data(), op.inputs),
                       .output_gradients = std::span(output_gradients.data(), op.outputs),
                       .output_gradient_rows = step.gradient_rows,
                       .params = std::span(params).subspan(op.first_param, op.params),
                       .csr = op.csr ? &op.csr : nullptr,
                       .extent = op.extent,
                       .active = active(op),
                       .scratch = &scratch});
  hold_in_capture(op.kernel);
  for (const auto& [s, from] : added_later) {
    Operand into = input(op, s).operand;
    into.range = *input_gradient(step, s);
    detail::accumulate(into, from);
  }
}

}  // namespace nova
