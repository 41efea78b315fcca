#include "novaphy/dynamics/diff_adjoint_record.h"

#include <cmath>
#include <utility>

#include "novaphy/core/error.h"
#include "novaphy/dynamics/diff_gradient_notes.h"
#include "novaphy/dynamics/semi_implicit/diff_noted_springs.h"
#include "novaphy/nova/op_list.h"

namespace novaphy {
namespace {

thread_local AdjointRecord* current_record = nullptr;

std::shared_ptr<AdjointRecord> record_of(const nova::Tape& tape) {
  for (const auto& witness : tape.witnesses())
    if (auto record = std::dynamic_pointer_cast<const AdjointRecord>(witness))
      return std::const_pointer_cast<AdjointRecord>(record);
  return nullptr;
}

// The leaves that have a gradient, and the unit vector against it.
struct Downhill {
  std::vector<nova::Tensor> leaves, tangents;
};
Downhill downhill(const AdjointRecord& record, const std::vector<nova::Tensor>& leaves) {
  Downhill to;
  double squares = 0.0;
  for (const nova::Tensor& leaf : leaves) {
    if (!leaf.has_grad()) continue;
    to.leaves.push_back(leaf);  // jvp reports a tensor that is no leaf of the tape
    to.tangents.emplace_back(leaf.shape(), nova::DType::F32, leaf.device());
    if (const std::vector<float>* const gradient = record.gradient(leaf))
      for (const float g : *gradient) squares += double{g} * g;
  }
  const double scale = squares > 0.0 ? -1.0 / std::sqrt(squares) : 0.0;
  for (size_t k = 0; k < to.leaves.size(); ++k) {
    auto* x = static_cast<float*>(to.tangents[k].range()->data());
    if (const std::vector<float>* const gradient = record.gradient(to.leaves[k]))
      for (const float g : *gradient) *x++ = static_cast<float>(scale * g);
  }
  return to;
}

std::vector<float> gradient_of(const nova::Tensor& leaf) {
  return leaf.has_grad() ? leaf.grad().to_host() : std::vector<float>();
}

}  // namespace

const std::vector<float>* AdjointRecord::gradient(const nova::Tensor& leaf) const {
  for (const auto& [of, numbers] : gradients)
    if (of.range() == leaf.range() && !numbers.empty()) return &numbers;
  return nullptr;
}
AdjointRecord::Step& AdjointRecord::add(const void* of) {
  step_index_[of] = steps.size();
  return steps.emplace_back();
}
AdjointRecord::Step* AdjointRecord::entry_of(const void* step) {
  if (current_record == nullptr) return nullptr;
  const auto found = current_record->step_index_.find(step);
  return found == current_record->step_index_.end() ? nullptr
                                                    : &current_record->steps[found->second];
}

AdjointRecord* AdjointRecord::current() { return current_record; }
AdjointRecord::Scope::Scope(AdjointRecord& record) { current_record = &record; }
AdjointRecord::Scope::~Scope() { current_record = nullptr; }

void backward_with_record(nova::Tape& tape, const nova::Tensor& loss, const nova::Tensor& seed) {
  require(!nova::current_capture(), ErrorKind::NotImplemented,
          "backward, record: not supported inside a ScopedCapture");
  bool has_steps = false;
  for (const auto& witness : tape.witnesses()) {
    const auto* const of = dynamic_cast<const GradientWitness*>(witness.get());
    if (of == nullptr) continue;
    has_steps = true;
    const char* const solver = of->without_record();
    require(solver == nullptr, ErrorKind::NotImplemented,
            "backward, record: not supported with steps of ", solver == nullptr ? "" : solver,
            ", only of DiffFeatherstoneSolver, of DiffSolverVBD, and of DiffSemiImplicitSolver for "
            "bodies with the contacts of a pipeline, on the CPU");
    of->begin_record();
  }
  require(has_steps, ErrorKind::Runtime,
          "backward, record: expected steps of DiffFeatherstoneSolver, DiffSemiImplicitSolver or "
          "DiffSolverVBD on the tape, got none");
  AdjointRecord record;
  record.loss = loss;
  for (const nova::Tensor& leaf : tape.leaves())
    record.gradients.emplace_back(leaf, gradient_of(leaf));
  {
    const AdjointRecord::Scope scope(record);
    tape.backward(loss, seed);
  }
  record.pass = tape.passes();
  for (auto& [leaf, numbers] : record.gradients) {  // leaves accumulate over passes
    const std::vector<float> before = std::exchange(numbers, gradient_of(leaf));
    for (size_t k = 0; k < before.size(); ++k) numbers[k] -= before[k];
  }
  for (const auto& witness : tape.witnesses())
    if (const auto* const of = dynamic_cast<const GradientWitness*>(witness.get()))
      of->add_to(record);
  if (const auto last = record_of(tape))
    *last = std::move(record);
  else
    tape.add_witness(std::make_shared<AdjointRecord>(std::move(record)));
}

std::shared_ptr<const AdjointRecord> adjoint_record(nova::Tape& tape,
                                                    const std::vector<nova::Tensor>& inputs) {
  const std::shared_ptr<AdjointRecord> record = record_of(tape);
  require(record != nullptr, ErrorKind::Runtime,
          "adjoint_record: expected backward(loss, record=True) before, got none");
  require(record->pass == tape.passes(), ErrorKind::Runtime,
          "adjoint_record: expected backward(loss, record=True) as the last backward of the tape, "
          "got one without a record behind it");
  bool all_springs = true;
  for (AdjointRecord::Step& step : record->steps) {
    step.changes.clear();
    step.moved.clear();
    all_springs = all_springs && step.of_springs;
  }
  const Downhill along = downhill(*record, inputs.empty() ? tape.leaves() : inputs);
  const AdjointRecord::Scope scope(*record);
  const auto run = [&] { tape.jvp({record->loss}, along.leaves, along.tangents); };
  if (!find_changes_of_springs(*record, run) || !all_springs) run();
  return record;
}

}  // namespace novaphy
