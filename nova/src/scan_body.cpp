#include "scan_body.h"

#include <algorithm>
#include <optional>

#include "novaphy/core/error.h"
#include "novaphy/core/parallel.h"
#include "novaphy/nova/op_list.h"

namespace nova {

using novaphy::fail;
using novaphy::require;

namespace {

Shape row_shape(const Tensor& rows) {
  const Shape& shape = rows.shape();
  return shape.size() > 1 ? Shape(shape.begin() + 1, shape.end()) : Shape(1, 1);
}
Shape rows_of_shape(int64_t rows, const Tensor& row) {
  Shape shape = row.shape();
  shape.insert(shape.begin(), rows);
  return shape;
}
std::vector<Tensor> stacked(const std::vector<Tensor>& rows, int64_t n) {
  std::vector<Tensor> found;
  for (const Tensor& row : rows)
    found.emplace_back(rows_of_shape(n, row), row.dtype(), row.device());
  return found;
}
bool holds(const std::vector<Tensor>& list, const Range& range) {
  return std::ranges::any_of(list, [&](const Tensor& t) { return t.range().get() == &range; });
}
constexpr size_t kMostInputs = 64, kMostOutputs = 32;  // of a custom operation

}  // namespace

void detail::copy_row(const Tensor& row, const Tensor& to, int64_t to_row, const Tensor& from,
                      int64_t from_row) {
  const auto bytes = static_cast<int64_t>(row.bytes());
  if (bytes == 0) return;
  submit_copy_bytes(novaphy::device_context(row.device()),
                    static_cast<char*>(to.range()->data()) + to_row * bytes,
                    static_cast<const char*>(from.range()->data()) + from_row * bytes, bytes);
}

Tape::ScanBody::ScanBody(const ScanFn& body, const std::vector<Tensor>& carry,
                         const std::vector<Tensor>& xs, int64_t steps)
    : steps_(steps), init_(carry), xs_(xs) {
  Tape* const outer = Tape::active();
  for (const Tensor& t : carry) {
    carry_.emplace_back(t.shape(), DType::F32, t.device());
    if (outer) carry_.back().set_requires_grad(true);
  }
  for (size_t k = 0; k < xs.size(); ++k) {
    x_.emplace_back(row_shape(xs[k]), xs[k].dtype(), xs[k].device());
    if (!outer || xs[k].dtype() != DType::F32 || !outer->impl_->carries(*xs[k].range())) continue;
    x_.back().set_requires_grad(true);
    moving_rows_.push_back(k);
  }
  if (outer) {
    tape_ = std::make_unique<Tape>(KeepGradients::Leaves);
    tape_->impl_->outer = outer;
  }
  record(body);
  check_writes();
  for (const Tensor& t : carry_) last_.emplace_back(t.shape(), DType::F32, t.device());
  ys_ = stacked(y_, steps_);
  if (tape_) find_reads();
}

void Tape::ScanBody::record(const ScanFn& body) {
  const detail::PartCapture capture("the body of a scan", "scan");
  list_ = capture.list();
  std::optional<TapeScope> scope;
  if (tape_) {
    scope.emplace(*tape_);
    tape_->begin_recomputed();
    tape_->impl_->records_body = true;
  }
  ScanResult result = body(carry_, x_);
  check_carry(result);
  own(result.carry);
  next_ = std::move(result.carry);
  own(result.ys);
  y_ = std::move(result.ys);
  if (tape_) {
    tape_->end_recomputed();
    tape_->impl_->records_body = false;
  }
}

void Tape::ScanBody::check_carry(const ScanResult& result) const {
  require(result.carry.size() == carry_.size(), ErrorKind::Value, "scan, body: expected ",
          carry_.size(), " tensors as the carry, got ", result.carry.size());
  for (size_t k = 0; k < carry_.size(); ++k) {
    const Tensor &is = result.carry[k], &was = carry_[k];
    require(is.defined(), ErrorKind::Value, "scan, body, carry ", k, ": the tensor is undefined");
    if (is.shape() != was.shape() || is.dtype() != DType::F32 || is.device() != was.device())
      fail(ErrorKind::Value, "scan, body, carry ", k, ": expected ", shape_str(was.shape()),
           " float32 on ", was.device().str(), " as before the step, got ", shape_str(is.shape()),
           " ", dtype_name(is.dtype()), " on ", is.device().str());
  }
  for (size_t k = 0; k < result.ys.size(); ++k)
    require(result.ys[k].defined() && !result.ys[k].shape().empty(), ErrorKind::Value,
            "scan, body, y ", k, ": expected a tensor with a shape");
}

// Replaces results that the body did not compute, or that it returned before, by copies.
void Tape::ScanBody::own(std::vector<Tensor>& results) const {
  for (size_t k = 0; k < results.size(); ++k) {
    const Range& range = *results[k].range();
    const std::vector<Tensor> before(results.begin(), results.begin() + static_cast<int64_t>(k));
    if (!list_->writes_to(range) || holds(before, range) || holds(next_, range))
      results[k] = results[k].clone();
  }
}

void Tape::ScanBody::check_writes() const {
  for (const auto* arguments : {&carry_, &x_})
    for (size_t k = 0; k < arguments->size(); ++k)
      require(!list_->writes_to(*(*arguments)[k].range()), ErrorKind::Value, "scan, body, ",
              arguments == &carry_ ? "carry " : "x ", k,
              ": the body writes to it; return a new tensor");
}

bool Tape::ScanBody::is_argument(const Range& range) const {
  return holds(carry_, range) || holds(x_, range);
}

void Tape::ScanBody::add_read(const Impl::Use& use) {
  const std::shared_ptr<Range>& range = use.operand.range;
  if (use.producer >= 0 || is_argument(*range)) return;
  if (list_->writes_to(*range)) {  // a constant that the body makes, for example by fill_
    require(range->version() == use.version && !use.carries, ErrorKind::Value,
            use.carries
                ? "scan, body: it reads a tensor with requires_grad that it wrote itself"
                : "scan, body: it reads a tensor and then writes to it; return a new tensor");
    return;
  }
  std::vector<Tensor>& list = use.carries ? outside_ : constants_;
  if (holds(list, *range)) return;
  const auto values = static_cast<int64_t>(range->bytes() / sizeof(float));
  list.emplace_back(range, Shape{values},
                    use.operand.type == ir::Type::F32 ? DType::F32 : DType::I32);
}

void Tape::ScanBody::find_reads() {
  Impl& body = *tape_->impl_;
  require(body.witnesses.empty(), ErrorKind::NotImplemented,
          "scan, body: a rollout that reports on its gradients is not supported; call rollout with "
          "several steps instead");
  for (const Impl::Op& op : body.ops) {
    for (uint32_t s = 0; s < op.inputs; ++s) add_read(body.input(op, s));
    if (op.csr && op.kernel)
      for (const Impl::CsrUse which : {Impl::kOffsets, Impl::kItems, Impl::kTable})
        add_read(body.csr_use(op, which));
    if (op.has_active) add_read(body.active_use(op));
    for (uint32_t o = 0; o < op.outputs; ++o)
      require(!body.uses[op.first_use + op.inputs + o].overwritten, ErrorKind::Value,
              "scan, body: the output of op '", body.op_name(op),
              "' is overwritten in the step; write to a new tensor");
  }
  leaves_ = carry_;
  for (const size_t k : moving_rows_) leaves_.push_back(x_[k]);
  leaves_.insert(leaves_.end(), outside_.begin(), outside_.end());
  require(leaves_.size() + constants_.size() + xs_.size() <= kMostInputs &&
              next_.size() + y_.size() <= kMostOutputs,
          ErrorKind::Value, "scan: expected at most ", kMostInputs,
          " tensors that the body reads and ", kMostOutputs, " results, got ",
          leaves_.size() + constants_.size() + xs_.size(), " and ", next_.size() + y_.size());
  Impl& tape = *body.outer->impl_;
  for (const Tensor& t : constants_) tape.check_not_overwritten(t.operand(), "scan", "constant");
  const auto carries = [&](const Tensor& t) { return tape.carries(*t.range()); };
  const bool recorded = tape.in_group || !moving_rows_.empty() || !outside_.empty() ||
                        std::ranges::any_of(init_, carries);
  if (!recorded) return tape_.reset();
  history_ = stacked(carry_, steps_);
  for (const Tensor& t : leaves_) places_.emplace_back(t.shape(), DType::F32, t.device());
  for (const auto* results : {&next_, &y_})
    for (const Tensor& t : *results)
      seeds_.push_back(t.dtype() == DType::F32 ? Tensor(t.shape(), DType::F32, t.device())
                                               : Tensor());
}

// Copies inputs of the operation that are one tensor, because each input has its own gradient.
void Tape::ScanBody::separate_inputs() {
  std::vector<Tensor> known = outside_;
  const auto separate = [&](Tensor& t) {
    if (holds(known, *t.range())) t = t.clone();
    known.push_back(t);
  };
  for (Tensor& t : init_) separate(t);
  for (const size_t k : moving_rows_) separate(xs_[k]);
}

void Tape::ScanBody::load(int64_t step) const {
  constexpr int64_t kStepsPerInterruptCheck = 64;
  if (step % kStepsPerInterruptCheck == 0) novaphy::check_interrupt();
  for (size_t k = 0; tape_ && k < carry_.size(); ++k)
    detail::copy_row(carry_[k], carry_[k], 0, history_[k], step);
  for (size_t k = 0; k < x_.size(); ++k) {
    detail::copy_row(x_[k], x_[k], 0, xs_[k], step);
    if (x_[k].dtype() != DType::F32) note_write(x_[k].range());  // may be an index table
  }
}

// Clears the gradients that a tape of the body gives to its arguments, which are new in each step.
void Tape::ScanBody::clear_gradients() const {
  if (tape_) return;
  for (const auto* arguments : {&carry_, &x_})
    for (const Tensor& t : *arguments)
      if (t.requires_grad()) t.zero_grad();
}

void Tape::ScanBody::forward() {
  hold_in_capture(shared_from_this());
  const auto before = [&](size_t k, int64_t step, const Tensor& from) {
    if (step == steps_) return detail::copy_row(carry_[k], last_[k], 0, from, 0);
    detail::copy_row(carry_[k], tape_ ? history_[k] : carry_[k], tape_ ? step : 0, from, 0);
  };
  for (size_t k = 0; k < carry_.size(); ++k) before(k, 0, init_[k]);
  for (int64_t step = 0; step < steps_; ++step) {
    load(step);
    clear_gradients();
    list_->submit();
    for (size_t k = 0; k < carry_.size(); ++k) before(k, step + 1, next_[k]);
    for (size_t k = 0; k < y_.size(); ++k) detail::copy_row(y_[k], ys_[k], step, y_[k], 0);
  }
  for (const auto* results : {&last_, &ys_})
    for (const Tensor& t : *results) note_write(t.range());
}

CustomOp Tape::ScanBody::custom_op() {
  const auto self = shared_from_this();
  CustomOp op{
      .name = "scan",
      .inputs = init_,
      .outputs = last_,
      .vjp = [self](std::span<const Tensor> outputs,
                    std::span<const InputGradient> inputs) { self->backward(outputs, inputs); },
      .forward = [self] { self->forward(); },
      .jvp = [self](std::span<const Tensor> inputs,
                    std::span<const Tensor> outputs) { self->tangent(inputs, outputs); },
      .reads = xs_,
      .submits_only = false};  // the scan launches lists of its own
  if (!tape_->has_tangents()) op.jvp = nullptr;
  for (const size_t k : moving_rows_) op.inputs.push_back(xs_[k]);
  for (const auto* list : {&outside_, &constants_})
    op.reads.insert(op.reads.end(), list->begin(), list->end());
  op.inputs.insert(op.inputs.end(), outside_.begin(), outside_.end());
  for (const Tensor& t : ys_)
    if (t.dtype() == DType::F32) op.outputs.push_back(t);
  return op;
}

ScanResult Tape::ScanBody::run() {
  if (tape_) separate_inputs();
  {
    const NoGrad no_grad;
    forward();
  }
  if (tape_) {
    Tape& outer = *tape_->impl_->outer;
    for (const auto& range : list_->written())
      outer.mark_untracked(range,
                           "it belongs to the body of a scan, whose last step it holds; "
                           "return it from the body");
    CustomOp op = custom_op();
    // The backward pass reads memory that only `forward` writes, so a group must run it again.
    if (outer.impl_->in_group && !op.outputs.empty()) op.reads.push_back(op.outputs[0]);
    if (!op.outputs.empty()) outer.record_custom(std::move(op));
  }
  return {last_, ys_};
}

}  // namespace nova
