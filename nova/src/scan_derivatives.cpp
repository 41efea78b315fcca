// The derivatives of a scan. Each step of the backward pass computes the step once more, and then
// runs the adjoints of its operations.
#include <algorithm>

#include "novaphy/core/error.h"
#include "novaphy/nova/op_list.h"
#include "scan_body.h"

namespace nova {

namespace {
uint64_t bit(size_t k) { return uint64_t{1} << k; }
void copy(const Tensor& to, const Tensor& from) { detail::copy_row(to, to, 0, from, 0); }
}  // namespace

// Gives a node of the body of a scan the memory of its gradient. See begin_contribution.
bool Tape::Impl::begin_in_body(Node& n) {
  if (n.ever_written) {
    n.place = pool.take(*n.range);
    return false;
  }
  LeafGradient& leaf = leaf_gradients.at(n.range.get());
  leaf.reached = true;
  n.place = &leaf.memory;
  return leaf.held;
}

// Returns the launches of a step of the backward pass. `seeded`: the results of the body that have
// a gradient, as bits. `held`: the leaves whose gradient has a value before the step. A
// contribution adds to a value that is held, and is stored otherwise, as in a loop without a scan.
const Tape::ScanBody::Pass& Tape::ScanBody::pass(uint32_t seeded, uint64_t held) {
  const auto known = passes_.find({seeded, held});
  if (known != passes_.end()) return known->second;
  Impl& body = *tape_->impl_;
  const detail::PartCapture capture("the backward pass of a scan", "scan");
  body.leaf_gradients.clear();
  for (size_t l = 0; l < leaves_.size(); ++l)
    body.leaf_gradients[leaves_[l].range().get()] = {places_[l].range(), (held & bit(l)) != 0};
  for (Impl::Node& n : body.nodes) {
    n.set = false;
    n.unread = 0;
  }
  for (size_t o = 0; o < seeds_.size(); ++o) {
    const Tensor& result = o < next_.size() ? next_[o] : y_[o - next_.size()];
    Impl::Node* const n = body.find(*result.range());
    if (!(seeded >> o & 1) || !n || !n->ever_written || !n->carries) continue;
    n->set = true;
    n->place = &seeds_[o].range();
  }
  body.plan_steps();
  // The list of a step, not the group of recorded operations, computes the step again, because it
  // has launches that no tape records, such as those of detach().
  std::erase_if(body.steps, [](const Impl::Step& step) { return step.op == nullptr; });
  body.run_steps(nullptr, {});
  body.pool.clear();
  body.scratch.clear();
  Pass made{capture.list()};
  for (size_t l = 0; l < leaves_.size(); ++l)
    if (body.leaf_gradients.at(leaves_[l].range().get()).reached) made.reached |= bit(l);
  return passes_[{seeded, held}] = made;
}

void Tape::ScanBody::backward(std::span<const Tensor> outputs,
                              std::span<const InputGradient> inputs) {
  hold_in_capture(shared_from_this());
  const size_t carries = carry_.size(), first_outside = carries + moving_rows_.size();
  std::vector<Tensor> of_results(seeds_.size());  // gradients of the results of the scan
  for (size_t o = 0, next = 0; o < seeds_.size(); ++o)
    if (seeds_[o].defined()) of_results[o] = outputs[next++];
  uint32_t seeded = 0, of_ys = 0;
  for (size_t o = 0; o < seeds_.size(); ++o) {
    if (!of_results[o].defined()) continue;
    hold_in_capture(of_results[o].range());
    if (o < carries) copy(seeds_[o], of_results[o]);
    (o < carries ? seeded : of_ys) |= uint32_t{1} << o;
  }
  for (const InputGradient& in : inputs)
    if (in.wanted()) hold_in_capture(in.grad.range());
  uint64_t held = 0;
  const auto hold = [&](size_t leaf) {
    if (!inputs[leaf].wanted() || !inputs[leaf].add) return;
    copy(places_[leaf], inputs[leaf].grad);
    held |= bit(leaf);
  };
  for (size_t l = first_outside; l < leaves_.size(); ++l) hold(l);
  for (int64_t step = steps_; step-- > 0;) {
    load(step);
    for (size_t o = carries; o < seeds_.size(); ++o)
      if (of_ys >> o & 1) detail::copy_row(seeds_[o], seeds_[o], 0, of_results[o], step);
    for (size_t l = 0; step == 0 && l < carries; ++l) hold(l);
    const Pass& p = pass(seeded | of_ys, held);
    list_->submit();
    p.list->submit();
    seeded = 0;
    for (size_t l = 0; l < carries; ++l) {
      if (!(p.reached & bit(l))) continue;
      seeded |= uint32_t{1} << l;
      copy(seeds_[l], places_[l]);
    }
    store_row_gradients(p, inputs, step);
    held |= p.reached & ~(bit(first_outside) - 1);
  }
  // The gradient of the first step's carry contains the value that it adds to.
  held = (held & ~(bit(carries) - 1)) | seeded;
  store_gradients(inputs, held);
}

void Tape::ScanBody::store_row_gradients(const Pass& pass, std::span<const InputGradient> inputs,
                                         int64_t step) {
  for (size_t l = carry_.size(); l < carry_.size() + moving_rows_.size(); ++l) {
    if (!inputs[l].wanted()) continue;
    if (!(pass.reached & bit(l))) submit_fill(places_[l].range(), 0.0f);
    row_gradients_.resize(moving_rows_.size());
    Tensor& sum = row_gradients_[rows_of(l)];
    if (inputs[l].add && !sum.defined())
      sum = Tensor(inputs[l].grad.shape(), DType::F32, inputs[l].grad.device());
    detail::copy_row(places_[l], inputs[l].add ? sum : inputs[l].grad, step, places_[l], 0);
  }
}

void Tape::ScanBody::store_gradients(std::span<const InputGradient> inputs, uint64_t held) const {
  for (size_t l = 0; l < leaves_.size(); ++l) {
    const InputGradient& in = inputs[l];
    const bool of_rows = l >= carry_.size() && l < carry_.size() + moving_rows_.size();
    if (!in.wanted()) continue;
    if (l < carry_.size() && steps_ == 0) {  // the result is the input
      in.put((held & bit(l)) != 0 ? seeds_[l] : Tensor());
    } else if (of_rows) {
      if (in.add && steps_ > 0)
        detail::accumulate(in.grad.flat_operand(), row_gradients_[rows_of(l)].flat_operand());
      if (steps_ == 0) in.put({});
    } else if ((held & bit(l)) != 0) {
      copy(in.grad, places_[l]);
    } else {
      in.put({});
    }
  }
}

// Records the tangent of a step. Every leaf has a tangent, which may be zero.
void Tape::ScanBody::record_tangent() {
  Impl& body = *tape_->impl_;
  const detail::PartCapture capture("the tangents of a scan", "scan");
  const NoGrad no_grad;
  std::vector<Tensor> inputs, tangents, outputs;
  for (size_t l = 0; l < leaves_.size(); ++l) {
    if (!tape_->has_leaf(leaves_[l])) continue;
    inputs.push_back(leaves_[l]);
    tangents.push_back(places_[l]);
  }
  std::vector<size_t> moving;
  for (size_t o = 0; o < seeds_.size(); ++o) {
    const Tensor& result = o < next_.size() ? next_[o] : y_[o - next_.size()];
    const Impl::Node* const n = body.find(*result.range());
    if (!n || !n->ever_written || !n->carries) continue;
    outputs.push_back(result);
    moving.push_back(o);
  }
  const std::vector<Tensor> found = tape_->jvp(outputs, inputs, tangents);
  next_tangents_.assign(seeds_.size(), Tensor());
  for (size_t k = 0; k < moving.size(); ++k) next_tangents_[moving[k]] = found[k];
  tangent_list_ = capture.list();
}

void Tape::ScanBody::tangent(std::span<const Tensor> inputs, std::span<const Tensor> outputs) {
  hold_in_capture(shared_from_this());
  if (!tangent_list_) record_tangent();
  const size_t carries = carry_.size(), first_outside = carries + moving_rows_.size();
  const auto store = [](const Tensor& to, const Tensor& from) {
    if (from.defined()) return copy(to, from);
    submit_fill(to.range(), 0.0f);
  };
  for (size_t l = 0; l < leaves_.size(); ++l)
    if (l < carries || l >= first_outside || !inputs[l].defined()) store(places_[l], inputs[l]);
  for (int64_t step = 0; step < steps_; ++step) {
    load(step);
    for (size_t l = carries; l < first_outside; ++l)
      if (inputs[l].defined()) detail::copy_row(places_[l], places_[l], 0, inputs[l], step);
    list_->submit();
    tangent_list_->submit();
    for (size_t l = 0; l < carries; ++l) store(places_[l], next_tangents_[l]);
    for (size_t o = carries, to = carries; o < seeds_.size(); ++o) {
      if (!seeds_[o].defined()) continue;
      store(seeds_[o], next_tangents_[o]);
      detail::copy_row(seeds_[o], outputs[to++], step, seeds_[o], 0);
    }
  }
  for (size_t l = 0; l < carries; ++l) copy(outputs[l], places_[l]);
}

}  // namespace nova
