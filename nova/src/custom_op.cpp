// Custom operations of a tape: recording them, and running their functions in backward.
#include "novaphy/nova/custom_op.h"

#include <algorithm>
#include <utility>

#include "novaphy/core/error.h"
#include "novaphy/nova/op_list.h"
#include "tape_impl.h"

namespace nova {

using novaphy::require;

namespace {

void check(const CustomOp& op) {
  require(static_cast<bool>(op.vjp), ErrorKind::Value,
          "record_custom, backward: expected a function");
  require(!op.outputs.empty(), ErrorKind::Value, "record_custom, outputs: expected at least one");
  require(op.inputs.size() <= 64 && op.outputs.size() <= 32, ErrorKind::Value,
          "record_custom: expected at most 64 inputs and 32 outputs, got ", op.inputs.size(),
          " and ", op.outputs.size());
  for (const auto* list : {&op.inputs, &op.outputs})
    for (const Tensor& tensor : *list)
      require(tensor.defined() && tensor.dtype() == DType::F32, ErrorKind::Type,
              "record_custom: expected float32 tensors");
  for (const auto* list : {&op.reads, &op.writes})
    for (const Tensor& tensor : *list)
      require(tensor.defined(), ErrorKind::Value, "record_custom '", op.name,
              "', reads and writes: expected tensors, got an undefined one");
  for (const Tensor& in : op.inputs) {
    for (const Tensor& out : op.outputs)
      require(!out.range()->overlaps(*in.range()), ErrorKind::Value, "record_custom '", op.name,
              "': an output overlaps an input");
    for (const Tensor& scratch : op.writes)
      require(!scratch.range()->overlaps(*in.range()), ErrorKind::Value, "record_custom '", op.name,
              "', writes: memory of an input");
  }
}

bool holds(const std::vector<Tensor>& list, const std::shared_ptr<Range>& range) {
  return std::any_of(list.begin(), list.end(), [&](const Tensor& t) { return t.range() == range; });
}

template <class F>
void run_functions(const CustomOp& op, DeferredScope& deferred, F&& functions) {
  if (!op.submits_only) deferred.pause();
  functions();
  // Hand-written launches of the functions raise no versions and keep no memory alive. This
  // function does both for them.
  for (const Tensor& scratch : op.writes) note_write(scratch.range());
  for (const auto* list : {&op.inputs, &op.outputs, &op.reads, &op.writes})
    for (const Tensor& tensor : *list) hold_in_capture(tensor.range());
  if (!op.submits_only) deferred.resume();
}

}  // namespace

void InputGradient::put(const Tensor& contribution) const {
  if (!contribution.defined()) {
    if (!add) submit_fill(grad.range(), 0.0f);
    return;
  }
  require(contribution.dtype() == DType::F32 && contribution.size() == grad.size(),
          ErrorKind::Value, "gradient of an input: expected ", shape_str(grad.shape()),
          " float32, got ", shape_str(contribution.shape()));
  if (add) {
    detail::accumulate(grad.operand(), contribution.operand());
  } else {
    submit_copy(grad.range(), contribution.range());
  }
}

CustomOp make_custom_op(std::string name, std::vector<Tensor> inputs, std::vector<Tensor> outputs,
                        BackwardFn backward) {
  CustomOp op{.name = name, .inputs = inputs, .outputs = std::move(outputs), .vjp = nullptr};
  op.reads = std::move(inputs);
  op.submits_only = false;
  if (!backward) return op;  // record_custom refuses it
  op.vjp = [name = std::move(name), backward = std::move(backward)](
               std::span<const Tensor> outs, std::span<const InputGradient> ins) {
    const std::vector<Tensor> grads = backward({outs.begin(), outs.end()});
    require(grads.size() == ins.size(), ErrorKind::Value, "op '", name, "': backward gave ",
            grads.size(), " gradients for ", ins.size(), " inputs");
    for (size_t s = 0; s < ins.size(); ++s) {
      if (!ins[s].wanted()) continue;
      const Tensor& to = ins[s].grad;
      if (const Tensor& grad = grads[s]; grad.defined())
        require(grad.dtype() == DType::F32 && grad.size() == to.size(), ErrorKind::Value, "op '",
                name, "', gradient of input ", s, ": expected ", shape_str(to.shape()),
                " float32, got ", shape_str(grad.shape()));
      ins[s].put(grads[s]);
    }
  };
  return op;
}

void Tape::record_custom(CustomOp op) {
  Impl& t = *impl_;
  check(op);
  bool carries = false;
  for (size_t k = 0; k < op.inputs.size(); ++k) {
    t.check_not_overwritten(op.inputs[k].operand(), op.name, "input " + std::to_string(k));
    carries = carries || t.carries(*op.inputs[k].range());
  }
  const bool recorded = carries && grad_enabled();
  if (!recorded)
    for (const Tensor& out : op.outputs) t.mark_constant(*out.range());
  if (!recorded && !(t.in_group && op.forward)) return;
  require(!t.in_group || op.forward, ErrorKind::NotImplemented, "record_custom '", op.name,
          "': between checkpoints operations are run once more, so it needs a forward function");
  std::vector<const Tensor*> values;  // values that vjp reads besides inputs and outputs
  for (const Tensor& value : op.reads) {
    if (holds(op.inputs, value.range()) || holds(op.outputs, value.range())) continue;
    require(value.dtype() != DType::F32 || !t.carries(*value.range()), ErrorKind::Runtime,
            "record_custom '", op.name,
            "', reads: it carries a gradient, which would stop here; make it an input");
    values.push_back(&value);
  }
  require(op.inputs.size() + values.size() <= 64, ErrorKind::Value, "record_custom '", op.name,
          "': expected at most 64 inputs and other values that it reads, got ",
          op.inputs.size() + values.size());
  Impl::Op record;
  record.constant = !recorded;
  record.group = t.in_group ? static_cast<int32_t>(t.groups.size()) - 1 : -1;
  record.first_use = static_cast<uint32_t>(t.uses.size());
  record.inputs = static_cast<uint32_t>(op.inputs.size() + values.size());
  record.outputs = static_cast<uint32_t>(op.outputs.size());
  record.custom = static_cast<int32_t>(t.customs.size());
  for (const Tensor& in : op.inputs)
    t.add_input(record, in.operand()).read = holds(op.reads, in.range());
  for (const Tensor* value : values)
    t.add_input(record, {value->range(), value->size(), 1, ir::Type::I32}).read = true;
  for (const Tensor& out : op.outputs) {
    Impl::Use& use = t.add_use(record, out.operand());
    use.carries = true;
    use.read = holds(op.reads, out.range());
    if (use.read && t.in_group) {
      use.producer = static_cast<int32_t>(t.uses.size()) - 1;
      record.replayed = true;
    }
  }
  t.customs.push_back(std::move(op));
  t.append(std::move(record), recorded);
}

std::string Tape::Impl::input_name(const Op& op, uint32_t k) const {
  if (op.kernel) return k < op.inputs ? op.kernel->sources[k].name : "active";
  if (op.custom < 0) return "input " + std::to_string(k);
  const size_t inputs = customs[static_cast<size_t>(op.custom)].inputs.size();
  if (k < inputs) return "input " + std::to_string(k);
  return k < op.inputs ? "value " + std::to_string(k - inputs) + " that it reads"
                       : "output " + std::to_string(k - op.inputs);
}

void Tape::Impl::check_read_values(const Op& op) {
  for (uint32_t u = 0; u < op.inputs + op.outputs; ++u) {
    const Use& use = uses[op.first_use + u];
    if (use.read) check_needed(use, op, u);
  }
}

void Tape::Impl::run_custom(const Step& step, DeferredScope& deferred) {
  const Op& op = *step.op;
  const CustomOp& custom = customs[static_cast<size_t>(op.custom)];
  std::vector<Tensor> outputs(op.outputs);
  for (uint32_t o = 0; o < op.outputs; ++o)
    if (const std::shared_ptr<Range>* place = output_gradient(step, o))
      outputs[o] = Tensor(*place, custom.outputs[o].shape(), DType::F32);
  std::vector<InputGradient> inputs(custom.inputs.size());
  for (uint32_t s = 0; s < inputs.size(); ++s) {
    const uint64_t bit = uint64_t{1} << s;
    if (!(step.key.wrt & bit)) continue;
    inputs[s].grad = Tensor(*input_gradient(step, s), custom.inputs[s].shape(), DType::F32);
    inputs[s].add = (step.key.accumulate & bit) != 0 || bound_before(op, s);
  }
  run_functions(custom, deferred, [&] {
    custom.vjp(outputs, inputs);
    for (const InputGradient& in : inputs)
      if (in.wanted()) note_write(in.grad.range());
  });
}

void Tape::Impl::run_custom_forward(const CustomOp& op, DeferredScope& deferred) {
  run_functions(op, deferred, [&] {
    op.forward();
    for (const Tensor& out : op.outputs) note_write(out.range());
  });
}

void Tape::Impl::run_custom_tangent(const CustomOp& op, std::span<const Tensor> inputs,
                                    std::span<const Tensor> outputs) {
  DeferredScope direct(false);
  run_functions(op, direct, [&] {
    op.jvp(inputs, outputs);
    for (const Tensor& out : outputs) note_write(out.range());
  });
  for (const auto list : {inputs, outputs})
    for (const Tensor& tensor : list)
      if (tensor.defined()) hold_in_capture(tensor.range());
}

}  // namespace nova
