// Tape::jvp: runs the tangent Program of each recorded operation, in order.
#include <algorithm>
#include <unordered_map>

#include "kernel_impl.h"
#include "novaphy/core/error.h"
#include "novaphy/core/parallel.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tangent_visitor.h"
#include "tape_impl.h"

namespace nova {

using detail::CompiledTangent;
using detail::Words;
using novaphy::fail;
using novaphy::Range;
using novaphy::require;
using novaphy::Storage;

namespace {
thread_local TangentVisitor* current_visitor = nullptr;
}
TangentVisitor::TangentVisitor() { current_visitor = this; }
TangentVisitor::~TangentVisitor() { current_visitor = nullptr; }
TangentVisitor* TangentVisitor::current() { return current_visitor; }

CompiledTangent& detail::KernelImpl::tangent(uint64_t wrt) {
  const std::lock_guard lock(mutex_);
  auto& slot = tangents_[wrt];
  if (!slot) {
    std::vector<bool> wanted;
    for (size_t s = 0; s < sources.size(); ++s) wanted.push_back(wrt >> s & 1);
    slot = std::make_unique<CompiledTangent>(make_tangent(traced, wanted));
  }
  return *slot;
}

class Tape::Impl::Forward {
 public:
  explicit Forward(Impl& tape) : t_(tape) {}

  // Sets the tangent of an input. Returns false if the input has a tangent already.
  bool seed(const Tensor& input, const Tensor& tangent) {
    return moving_.try_emplace(input.range().get(), Moving{tangent.range(), 0, true}).second;
  }

  void run() {
    constexpr size_t kOpsPerInterruptCheck = 64;
    for (size_t k = 0; k < t_.ops.size(); ++k) {
      if (k % kOpsPerInterruptCheck == 0) novaphy::check_interrupt();
      const Op& op = t_.ops[k];
      if (op.constant) continue;
      if (const uint64_t wrt = moving_inputs(op); wrt != 0) {
        push(op, wrt);
      } else {  // the outputs no longer depend on the inputs
        for (uint32_t o = 0; o < op.outputs; ++o) moving_.erase(t_.output(op, o).range.get());
      }
    }
  }

  Tensor of(const Tensor& output) const {
    const auto found = moving_.find(output.range().get());
    if (found == moving_.end()) return Tensor(output.shape(), DType::F32, output.device());
    return Tensor(found->second.tangent, output.shape(), DType::F32);
  }

 private:
  struct Moving {
    std::shared_ptr<Range> tangent;
    uint64_t version = 0;  // version of a leaf's value at its first read
    bool leaf = false;
  };

  // Returns the inputs that have a tangent, as bits.
  uint64_t moving_inputs(const Op& op) {
    uint64_t wrt = 0;
    for (uint32_t s = 0; s < op.inputs; ++s) {
      const Use& use = t_.input(op, s);
      const auto found = use.carries ? moving_.find(use.operand.range.get()) : moving_.end();
      if (found == moving_.end()) continue;
      wrt |= uint64_t{1} << s;
      Moving& m = found->second;
      if (!m.leaf) continue;
      if (m.version == 0) m.version = use.version;
      require(m.version == use.version, ErrorKind::Runtime, "jvp: input '", t_.input_name(op, s),
              "' of op '", t_.op_name(op),
              "' was read with different values, and one tangent cannot be of both");
    }
    return wrt;
  }

  void push(const Op& op, uint64_t wrt) {
    if (op.group >= 0 && op.group != group_ && !t_.outer) {
      group_ = op.group;
      t_.check_group(t_.groups[static_cast<size_t>(group_)]);
      DeferredScope direct(false);
      t_.run_group(t_.groups[static_cast<size_t>(group_)], direct);
    }
    if (!op.kernel) return push_custom(op, t_.customs[static_cast<size_t>(op.custom)]);
    CompiledTangent& compiled = op.kernel->tangent(wrt);
    for (uint32_t s = 0; s < op.inputs; ++s)
      if (compiled.plan.loads_value[s]) t_.check_needed(t_.input(op, s), op, s);
    if (op.has_active) t_.check_needed(t_.active_use(op), op, op.inputs);
    if (op.csr && !compiled.code.program.loops.empty()) t_.check_csr(op, {kOffsets, kItems});
    launch(op, wrt, compiled.code);
  }

  void push_custom(const Op& op, const CustomOp& custom) {
    require(static_cast<bool>(custom.jvp), ErrorKind::NotImplemented, "jvp: op '", custom.name,
            "' was recorded without one");
    t_.check_read_values(op);
    std::vector<Tensor> in, out;
    for (const Tensor& t : custom.inputs) {
      const auto found = moving_.find(t.range().get());
      in.push_back(found == moving_.end() ? Tensor()
                                          : Tensor(found->second.tangent, t.shape(), DType::F32));
    }
    for (const Tensor& t : custom.outputs) out.emplace_back(t.shape(), DType::F32, t.device());
    t_.run_custom_tangent(custom, in, out);
    for (size_t o = 0; o < out.size(); ++o)
      moving_[custom.outputs[o].range().get()] = {out[o].range()};
  }

  void launch(const Op& op, uint64_t wrt, detail::Executable& code) {
    std::vector<std::shared_ptr<Range>> made;
    for (uint32_t o = 0; o < op.outputs; ++o) {
      const Range& like = *t_.output(op, o).range;
      made.push_back(Storage::allocate(like.bytes(), like.storage().device(), false)->range());
    }
    if (op.has_active)  // rows that were not computed have the tangent 0
      for (const auto& range : made) submit_fill(range, 0.0f);
    Words words(code.argument_count);
    const auto source = [&](const std::shared_ptr<Range>& range, int64_t rows) {
      words.pointer(range->data());
      words.word(static_cast<uint64_t>(rows));
      hold_in_capture(range);
    };
    for (uint32_t s = 0; s < op.inputs; ++s)
      source(t_.input(op, s).operand.range, t_.input(op, s).operand.rows);
    for (uint32_t s = 0; s < op.inputs; ++s)
      if (wrt >> s & 1)
        source(moving_.at(t_.input(op, s).operand.range.get()).tangent,
               t_.input(op, s).operand.rows);
    for (const auto& range : made) words.pointer(range->data());
    detail::ExtraReads reads;
    if (op.kernel->has_csr_loop && !code.program.loops.empty()) {
      words.pointer(op.csr->offsets->data());
      words.pointer(op.csr->items->data());
      reads.add(*op.csr);
    }
    const int32_t* const active = detail::active_count(t_.active(op));
    reads.add(active);
    for (uint32_t k = 0; k < op.params; ++k) words.word(t_.params[op.first_param + k].bits);
    if (op.kernel->has_fixed_loop) words.word(static_cast<uint32_t>(op.extent));
    const novaphy::DeviceContext& context = novaphy::device_context(made[0]->storage().device());
    submit_launch(context, code.get(context), code.program.name.c_str(), op.dim, words.span(),
                  &code.layout, reads.span(), active);
    if (active) hold_in_capture(t_.active(op)->range);
    hold_in_capture(op.kernel);
    if (op.csr) hold_in_capture(op.csr);
    for (uint32_t o = 0; o < op.outputs; ++o) {
      note_write(made[o]);
      hold_in_capture(made[o]);
      moving_[t_.output(op, o).range.get()] = {made[o]};
    }
    TangentVisitor* const visitor = TangentVisitor::current();
    if (visitor == nullptr) return;
    std::vector<Operand> inputs;
    for (uint32_t s = 0; s < op.inputs; ++s) inputs.push_back(t_.input(op, s).operand);
    visitor->visit(op.kernel->name, inputs, made);
  }

  Impl& t_;
  // ranges that depend on the inputs at this point
  std::unordered_map<const Range*, Moving> moving_;
  int32_t group_ = -1;                               // the group that was recomputed last
};

bool Tape::has_leaf(const Tensor& tensor) const {
  const Impl::Node* n = impl_->find(*tensor.range());
  return n && !n->ever_written && impl_->carries(*tensor.range());
}
std::vector<Tensor> Tape::leaves() const {
  std::vector<Tensor> found;
  for (const Impl::Node& n : impl_->nodes) {
    if (n.ever_written || !impl_->carries(*n.range)) continue;
    const auto size = static_cast<int64_t>(n.range->bytes() / sizeof(float));
    found.emplace_back(n.range, std::vector<int64_t>{size}, DType::F32);
  }
  return found;
}
bool Tape::has_tangents() const {
  return std::all_of(impl_->ops.begin(), impl_->ops.end(), [this](const Impl::Op& op) {
    return op.constant || op.kernel || impl_->customs[static_cast<size_t>(op.custom)].jvp;
  });
}

std::vector<Tensor> Tape::jvp(const std::vector<Tensor>& outputs, const std::vector<Tensor>& inputs,
                              const std::vector<Tensor>& tangents) {
  require(inputs.size() == tangents.size(), ErrorKind::Value, "jvp, tangents: expected ",
          inputs.size(), ", one per input, got ", tangents.size());
  const novaphy::ExclusiveUse::Scope use(impl_->in_use, "jvp", "the tape");
  Impl::Forward forward(*impl_);
  for (size_t k = 0; k < inputs.size(); ++k) {
    const Tensor &input = inputs[k], &tangent = tangents[k];
    require(input.defined() && tangent.defined(), ErrorKind::Value, "jvp, input ", k,
            ": expected a tensor and its tangent, got none");
    require(has_leaf(input), ErrorKind::Value, "jvp, input ", k,
            ": expected a leaf that this tape read with requires_grad set");
    require(tangent.dtype() == DType::F32 && tangent.size() == input.size() &&
                tangent.device() == input.device(),
            ErrorKind::Value, "jvp, tangent ", k, ": expected ", shape_str(input.shape()),
            " float32 on ", input.device().str(), ", got ", shape_str(tangent.shape()), " ",
            dtype_name(tangent.dtype()), " on ", tangent.device().str());
    require(forward.seed(input, tangent), ErrorKind::Value, "jvp, input ", k,
            ": expected each input once, got the same memory again");
  }
  for (size_t k = 0; k < outputs.size(); ++k) {
    require(outputs[k].defined(), ErrorKind::Value, "jvp, output ", k, ": the tensor is undefined");
    const Impl::Node* n = impl_->find(*outputs[k].range());
    require(n && n->ever_written && n->carries, ErrorKind::Value, "jvp, output ", k,
            ": no operation of this tape wrote it from an input with a gradient");
    require(impl_->outer || n->written_version == impl_->version_of(*n->range), ErrorKind::Runtime,
            "jvp, output ", k, ": it was overwritten after recording");
  }
  NoGrad no_grad;
  forward.run();
  std::vector<Tensor> results;
  for (const Tensor& output : outputs) results.push_back(forward.of(output));
  return results;
}

}  // namespace nova
