#include "novaphy/nova/tape.h"

#include "novaphy/core/error.h"
#include "novaphy/nova/op_list.h"
#include "observer.h"
#include "tape_impl.h"

namespace nova {

using detail::KernelImpl;
using novaphy::fail;
using novaphy::require;

namespace {
thread_local Tape* active_tape = nullptr;
thread_local int no_grad_depth = 0;
}  // namespace

bool Tape::Impl::carries(const Range& range) {
  const GradInfo* info = find_grad_info(range);
  if (!info) return false;  // the range does not take part in differentiation
  const Node* n = find(range);
  if (n && n->ever_written) return n->carries;
  return outer ? outer->impl_->carries(range) : info->requires_grad;
}

// Returns the checksum of an exported value, computed once per version.
bool Tape::Impl::note_exported_value(const Range& range, uint64_t& checksum) {
  Value& value = values[&range];
  if (value.version != range.version()) value = {range.version(), checksum_now(range)};
  checksum = value.checksum;
  return true;
}

Tape::Impl::Use& Tape::Impl::add_use(const Op& op, const Operand& operand) {
  Use& use = uses.emplace_back();
  use.operand = operand;
  use.version = version_of(*operand.range);
  use.capture = op.capture;
  use.carries = operand.type == ir::Type::F32 && carries(*operand.range);
  use.has_checksum = note_value(*operand.range, op.capture, use.checksum);
  return use;
}

Tape::Impl::Use& Tape::Impl::add_input(const Op& op, const Operand& operand) {
  Use& use = add_use(op, operand);
  if (use.carries) node(operand.range);
  const Node* n = op.group >= 0 ? find(*operand.range) : nullptr;
  if (n && n->group == op.group) {
    use.producer = n->written_use;
    ops[static_cast<size_t>(n->writer)].replayed = true;
  }
  return use;
}

// Appends an operation, whose uses are the last ones in `uses`.
void Tape::Impl::append(Op op, bool recorded) {
  op.step = of_step;
  ops.push_back(std::move(op));
  const auto number = static_cast<int32_t>(ops.size()) - 1;
  for (uint32_t o = 0; o < ops.back().outputs; ++o) {
    const std::shared_ptr<Range>& range = output(ops.back(), o).range;
    if (recorded) mark_output(range, number);
    if (!in_group) continue;
    Node& n = node(range);
    if (n.group == ops.back().group) uses[static_cast<size_t>(n.written_use)].overwritten = true;
    n.writer = number;
    n.group = ops.back().group;
    n.written_use = static_cast<int32_t>(ops.back().first_use + ops.back().inputs + o);
  }
  if (in_group) groups.back().last = static_cast<uint32_t>(ops.size());
}

// Throws if a capture reads an exported value from outside of the capture.
void Tape::Impl::refuse_export_in_capture() {
  fail(ErrorKind::Runtime,
       "tape: an array with a writable export cannot be followed into, or out of, a ScopedCapture; "
       "capture forward and backward together");
}

uint64_t Tape::Impl::checksum_now(const Range& range) {
  flush_deferred();
  return range.checksum();
}

// Returns whether the recorded value of the node has been overwritten.
bool Tape::Impl::was_written_outside(const Node& n) {
  if (n.written_version != version_of(*n.range)) return true;
  if (!n.has_checksum && !n.range->was_exported()) return false;
  const OpList* graph = current_capture();
  if (n.capture != (graph ? graph->id() : 0)) refuse_export_in_capture();
  return !graph && checksum_now(*n.range) !=
                       (n.has_checksum ? n.written_checksum : n.range->exported_checksum());
}

void Tape::Impl::check_not_of_another(const Range& range, const std::string& op,
                                      const std::string& input) {
  if (is_of_another(range)) [[unlikely]]
    fail(ErrorKind::Runtime, "input '", input, "' of op '", op,
         "' was recorded by another tape that is still alive; its gradient would silently stop "
         "here. Record both on one tape, take detach(), or reset() the other tape");
}

// Checks that no code outside of the tape overwrote an input, whose gradient would be wrong.
void Tape::Impl::check_not_overwritten(const Operand& in, const std::string& op,
                                       const std::string& input) {
  if (in.type == ir::Type::F32) {
    check_not_of_another(*in.range, op, input);
    // Gradients belong to ranges, so the gradient of a range that overlaps the input would be lost.
    const auto has_gradient = [](const Range& other, void* self) {
      return static_cast<Impl*>(self)->carries(other) ||
             static_cast<Impl*>(self)->is_of_another(other);
    };
    if (const Range* const other = in.range->find_overlap(has_gradient, this)) {
      check_not_of_another(*other, op, input);
      fail(ErrorKind::Runtime, "input '", input, "' of op '", op,
           "' is a view of bytes whose gradient belongs to another view; use the view that was "
           "recorded or requires it");
    }
  }
  if (!find_grad_info(*in.range)) return;
  const Node* n = find(*in.range);
  if (n && n->untracked && n->untracked_version == in.range->version())
    fail(ErrorKind::Runtime, "input '", input, "' of op '", op, "': ", n->untracked);
  if (n && n->ever_written && n->carries && was_written_outside(*n))
    fail(ErrorKind::Runtime, "input '", input, "' of op '", op, "' was written by op '",
         op_name(ops[n->writer]),
         "' of this tape and then overwritten outside of it; its gradient would be wrong");
}

bool Tape::Impl::was_modified_outside(const Use& use) {
  const Range& range = *use.operand.range;
  const OpList* graph = current_capture();
  if (use.capture != (graph ? graph->id() : 0)) refuse_export_in_capture();
  if (graph) return false;
  const auto [at, first] = present.try_emplace(&range);
  if (first) at->second = checksum_now(range);
  return at->second != (use.has_checksum ? use.checksum : range.exported_checksum());
}

void Tape::Impl::check_value(const Use& use, const Op& op, uint32_t input) {
  if (was_modified(use)) [[unlikely]]
    fail(ErrorKind::Runtime, "input '", input_name(op, input), "' of op '", op_name(op),
         "' was modified after recording");
}

void Tape::Impl::mark_output(const std::shared_ptr<Range>& range, int32_t op) {
  GradInfo& info = grad_info(*range);
  Node& n = node(range);
  n.writer = op;
  if (!in_group) n.group = -1;
  n.written_version = range->version();
  n.capture = ops[static_cast<size_t>(op)].capture;
  n.has_checksum = note_value(*range, n.capture, n.written_checksum);
  n.ever_written = true;
  n.carries = true;
  n.untracked = nullptr;
  ++info.producers;
  info.last_tape = this;
  info.recorded_version = range->version();
}

void Tape::Impl::mark_constant(const Range& range) {
  if (Node* n = find(range)) {
    n->carries = false;
    n->written_version = range.version();
  }
}

void Tape::Impl::forget() {
  for (const Op& op : ops) {
    if (op.constant) continue;
    for (uint32_t o = 0; o < op.outputs; ++o)
      if (GradInfo* info = find_grad_info(*output(op, o).range)) {
        --info->producers;
        if (info->last_tape == this) info->last_tape = nullptr;
      }
  }
  ops.clear();
  groups.clear();
  group_memory.clear();
  in_group = false;
  uses.clear();
  params.clear();
  customs.clear();
  witnesses.clear();
  passes = 0;
  hand_written.clear();
  nodes.clear();
  values.clear();
  written_again.clear();
  outer = nullptr;
  leaf_gradients.clear();
}

void Tape::mark_untracked(const std::shared_ptr<Range>& range, const char* why) {
  grad_info(*range);
  Impl::Node& n = impl_->node(range);
  n.untracked_version = range->version();
  n.untracked = why;
}

// Memory of a destroyed tape, which the next tape reuses. A loop may make one tape per iteration.
std::unique_ptr<Tape::Impl>& Tape::spare() {
  thread_local std::unique_ptr<Impl> impl;
  return impl;
}

Tape::Tape(KeepGradients keep) : impl_(std::move(spare())) {
  if (!impl_) impl_ = std::make_unique<Impl>();
  impl_->leaves_only = keep == KeepGradients::Leaves;
}
Tape::~Tape() {
  if (active_tape == this) end();
  impl_->forget();
  spare() = std::move(impl_);
}

void Tape::begin() {
  require(
      active_tape == impl_->outer, ErrorKind::Runtime,
      active_tape == this ? "tape: already active" : "tape: another tape is active on this thread");
  active_tape = this;
  detail::enter_observation();
}
void Tape::end() {
  require(active_tape == this, ErrorKind::Runtime, "tape: not active on this thread");
  active_tape = impl_->outer;
  detail::leave_observation();
}
Tape* Tape::active() { return no_grad_depth == 0 ? active_tape : nullptr; }

NoGrad::NoGrad() { ++no_grad_depth; }
NoGrad::~NoGrad() { --no_grad_depth; }
bool grad_enabled() { return no_grad_depth == 0; }

bool Tape::must_record(std::span<const Operand> inputs) const {
  for (const Operand& in : inputs)
    if (in.type == ir::Type::F32 && impl_->carries(*in.range)) return true;
  return false;
}

bool Tape::carries_gradient(const Range& range) const {
  const auto carries = [](const Range& other, void* self) {
    return static_cast<Impl*>(self)->carries(other);
  };
  return impl_->carries(range) || range.find_overlap(carries, impl_.get()) != nullptr;
}
void Tape::mark_constant(const Range& range) { impl_->mark_constant(range); }
void Tape::check_not_of_another(const Range& range, const std::string& op,
                                const std::string& input) const {
  impl_->check_not_of_another(range, op, input);
  const auto of_another = [](const Range& other, void* self) {
    return static_cast<Impl*>(self)->is_of_another(other);
  };
  if (const Range* const other = range.find_overlap(of_another, impl_.get()))
    impl_->check_not_of_another(*other, op, input);
}

void Tape::check_launch(const KernelImpl& kernel, std::span<const Operand> inputs,
                        std::span<const Operand> partly) const {
  for (size_t o = 0; o < partly.size(); ++o) {
    const Impl::Node* n = impl_->find(*partly[o].range);
    require(!impl_->carries(*partly[o].range) && (!n || n->writer < 0), ErrorKind::Runtime,
            kernel.name, ", output '", kernel.outputs[o].name,
            "': only the active rows are written, and the tape knows the memory already; its other "
            "rows would keep values without their gradient. Give it memory of its own");
  }
  for (size_t s = 0; s < inputs.size(); ++s)
    impl_->check_not_overwritten(inputs[s], kernel.name, kernel.sources[s].name);
}

void Tape::record_launch(const std::shared_ptr<KernelImpl>& kernel, int64_t dim,
                         std::span<const Operand> inputs, std::span<const Operand> outputs,
                         const LaunchOptions& options, bool recorded) {
  Impl& t = *impl_;
  if (!recorded) {
    for (const Operand& out : outputs) t.mark_constant(*out.range);
    if (!t.in_group) return;
  }
  Impl::Op op;
  op.kernel = kernel;
  op.constant = !recorded;
  op.group = t.in_group ? static_cast<int32_t>(t.groups.size()) - 1 : -1;
  op.dim = dim;
  op.first_use = static_cast<uint32_t>(t.uses.size());
  op.inputs = static_cast<uint32_t>(inputs.size());
  op.outputs = static_cast<uint32_t>(outputs.size());
  op.first_param = static_cast<uint32_t>(t.params.size());
  op.params = static_cast<uint32_t>(options.params.size());
  op.extent = options.extent;
  if (options.csr) op.csr = *options.csr;
  for (const Operand& in : inputs) t.add_input(op, in);
  for (const Operand& out : outputs)
    t.uses.push_back({.operand = out, .version = t.version_of(*out.range), .carries = true});
  if (op.csr) t.add_csr(op);
  if (options.active) {
    op.has_active = true;
    t.add_input(op, *options.active);
  }
  t.params.insert(t.params.end(), options.params.begin(), options.params.end());
  t.append(std::move(op), recorded);
}

// Records a rebuild for a recomputed group, whose operations need the rebuilt rows again.
void Tape::record_rebuild(const Incidence& incidence) {
  Impl& t = *impl_;
  if (!t.in_group) return;
  Impl::Op op;
  op.constant = true;
  op.group = static_cast<int32_t>(t.groups.size()) - 1;
  op.first_use = static_cast<uint32_t>(t.uses.size());
  op.inputs = 1;
  op.outputs = 2;
  op.csr = incidence;
  t.add_input(op, incidence->table);
  for (const auto& range : {incidence->offsets, incidence->items})
    t.uses.push_back({.operand = Impl::words_of(range), .version = t.version_of(*range)});
  t.append(std::move(op), false);
}

void Tape::record_launch(const novaphy::Launch& launch,
                         std::span<const detail::MemoryAccess> accesses) {
  Impl& t = *impl_;
  if (!t.in_group) return;
  Impl::Op op;
  op.constant = true;
  op.group = static_cast<int32_t>(t.groups.size()) - 1;
  op.first_use = static_cast<uint32_t>(t.uses.size());
  op.hand_written = static_cast<int32_t>(t.hand_written.size());
  for (const novaphy::LaunchArgument& a : launch.arguments)
    if (a.read && a.range) {
      t.add_input(op, Impl::words_of(a.range));
      ++op.inputs;
    }
  for (const novaphy::LaunchArgument& a : launch.arguments)
    if (a.write && a.range) {
      t.uses.push_back({.operand = Impl::words_of(a.range), .version = t.version_of(*a.range)});
      ++op.outputs;
    }
  t.hand_written.push_back({&launch.context,
                            launch.kernel,
                            launch.name,
                            launch.n,
                            {launch.words.begin(), launch.words.end()},
                            {accesses.begin(), accesses.end()}});
  t.append(std::move(op), false);
}

// Records the use of the rows of a CSR sum, and of the table that the rows were built from.
void Tape::Impl::add_csr(const Op& op) {
  const IncidenceData& csr = *op.csr;
  const bool current = is_current(csr, *csr.table.range);
  for (const auto& range : {csr.offsets, csr.items}) add_input(op, words_of(range));
  add_input(op, csr.table);
  Use& table = uses.back();
  if (!current) table.version = kOutdated;  // no adjoint can find the row of an item
  if (table.has_checksum && csr.has_checksum) table.checksum = csr.checksum;
}

void Tape::begin_recomputed(const std::shared_ptr<novaphy::ExclusiveUse>& memory) {
  require(!impl_->in_group, ErrorKind::Runtime, "begin_recomputed: inside another");
  if (memory) impl_->group_memory.add(memory);
  impl_->in_group = true;
  const auto first = static_cast<uint32_t>(impl_->ops.size());
  impl_->groups.push_back({first, first});
}
void Tape::end_recomputed() { impl_->in_group = false; }

Tape::StepScope::StepScope(int32_t step) : tape_(active()) {
  if (tape_) tape_->impl_->of_step = step;
}
Tape::StepScope::~StepScope() {
  if (tape_) tape_->impl_->of_step = -1;
}

void Tape::backward(const Tensor& loss, const Tensor& seed) {
  require(loss.defined(), ErrorKind::Value, "backward, loss: the tensor is undefined");
  impl_->check_no_body("Tape.backward");
  const novaphy::ExclusiveUse::Scope use(impl_->in_use, "backward", "the tape");
  Impl::Node* n = impl_->find(*loss.range());
  require(
      n && n->ever_written && n->carries, ErrorKind::Value,
      "backward, loss: no operation of this tape wrote it from an input with a gradient; make a "
      "leaf before recording, with requires_grad=True of a tensor, of a view of an array, or of "
      "the state that a solver starts from");
  require(n->written_version == impl_->version_of(*n->range), ErrorKind::Runtime,
          "backward, loss: it was overwritten after recording");
  if (seed.defined() && (seed.dtype() != DType::F32 || seed.size() != loss.size()))
    fail(ErrorKind::Value, "backward, grad: expected ", shape_str(loss.shape()), " float32, got ",
         shape_str(seed.shape()), " ", dtype_name(seed.dtype()));
  if (!seed.defined() && loss.size() != 1)
    fail(ErrorKind::Value, "backward, loss: expected one value (or pass grad), got shape ",
         shape_str(loss.shape()));
  NoGrad no_grad;
  impl_->backward(*n, seed);
  ++impl_->passes;
}

}  // namespace nova
