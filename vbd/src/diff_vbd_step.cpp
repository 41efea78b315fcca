#include "diff_vbd_step.h"

#include <algorithm>
#include <string_view>
#include <utility>

#include "element_arrays.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/named_step.h"
#include "novaphy/nova/host_work.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/op_list.h"

namespace novaphy::diff {
namespace {

using nova::Tensor;

// Returns the tensor's memory as rows of three floats. An undefined tensor gives an array without
// rows.
DeviceArray<Vec3f> array_of(const Tensor& tensor) {
  if (!tensor.defined() || tensor.size() == 0) return {};
  return DeviceArray<Vec3f>(
      Array(novaphy::DType::vec3, static_cast<size_t>(tensor.size() / 3), 1, tensor.range()));
}
// Returns some rows of a tensor, as a tensor whose range is a part of the same memory.
Tensor part_of(const Tensor& all, size_t first_row, size_t rows) {
  const auto row = static_cast<size_t>(all.shape().back()) * sizeof(float);
  const auto& range = all.range();
  return {range->storage().range(range->offset() + first_row * row, rows * row),
          {static_cast<int64_t>(rows), all.shape().back()},
          nova::DType::F32};
}

bool in_a_capture_of_the_host(const RecordedStep& step) {
  return nova::current_capture() != nullptr && !step.on_device();
}

}  // namespace

// Arrays of the model that have a gradient. The arrays of elements are not in this list.
#define NOVAPHY_VBD_MODEL_INPUTS(X) \
  X(gravity)                        \
  X(particle_mass)                  \
  X(particle_radius)                \
  X(shape_margin)                   \
  X(shape_material_ke)              \
  X(shape_material_kd)              \
  X(shape_material_mu)

std::vector<RecordedStep::Input> RecordedStep::differentiable() const {
  std::vector<Input> all;
  const Model& m = *model;
#define NOVAPHY_ADD(input, name) all.push_back({input, &VbdStepDerivatives::name})
#define NOVAPHY_ADD_ARRAY(array, name) \
  if ((array).rows() != 0) NOVAPHY_ADD(tensor_of(nova::operand_of(array)), name)
  NOVAPHY_ADD(q, particle_q);
  NOVAPHY_ADD(qd, particle_qd);
  NOVAPHY_ADD(f, particle_f);
  if (targets.defined()) {
    NOVAPHY_ADD(targets, targets);
    all.back().is_targets = true;
  }
  if (last.defined()) NOVAPHY_ADD(last, last_velocity);
#define NOVAPHY_ADD_PARAMETERS(name, columns, width, use) \
  NOVAPHY_ADD_ARRAY(vbd::source_of<vbd::use>(activations, m).name, name);
#define NOVAPHY_ADD_MODEL(name) NOVAPHY_ADD_ARRAY(m.name, name);
  NOVAPHY_VBD_PARAMETERS(NOVAPHY_ADD_PARAMETERS)
  NOVAPHY_VBD_MODEL_INPUTS(NOVAPHY_ADD_MODEL)
#undef NOVAPHY_ADD_MODEL
#undef NOVAPHY_ADD_PARAMETERS
#undef NOVAPHY_ADD_ARRAY
#undef NOVAPHY_ADD
  return all;
}

bool RecordedStep::trains(const nova::Tape& tape) const {
  if (!on_device() || nova::current_capture() == nullptr) return false;
  bool any = false;
  vbd::for_each_kind([&](auto is) {
    decltype(is)::Slot::for_arrays(*model, [&](const char*, const Array& array, int,
                                               vbd::ArrayUse use) {
      any |= use != vbd::kActivation && array.rows() != 0 && tape.carries_gradient(*array.range());
    });
  });
  return any;
}

void check_other_arrays(const nova::Tape& tape, const Model& model, const Contacts* given,
                        const std::vector<Tensor>& inputs) {
  const auto check = [&](const char* of, const FieldInfo& info, const Array& array) {
    if (array.rows() == 0 || !tape.carries_gradient(*array.range())) return;
    for (const Tensor& input : inputs)
      if (input.range()->overlaps(*array.range())) return;
    fail(ErrorKind::NotImplemented, RecordedStep::kName, ": ", of, ".", info.name,
         ": a step of VBD has no gradient by it; set requires_grad = false there");
  };
  ModelFields::visit(static_cast<const ModelFields&>(model),
                     [&](const FieldInfo& info, const Array& array) {
                       const std::string_view name = info.name;
                       for (const char* const of_state : {"particle_q", "particle_qd", "body_q",
                                                          "body_qd", "joint_q", "joint_qd"})
                         if (name == of_state) return;
                       check("model", info, array);
                     });
  if (given != nullptr)
    ContactFields::visit(
        static_cast<const ContactFields&>(*given),
        [&](const FieldInfo& info, const Array& array) { check("contacts", info, array); });
}

void RecordedStep::check_others(const nova::Tape& tape, const Contacts* given) const {
  std::vector<Tensor> inputs;
  for (const Input& input : differentiable()) inputs.push_back(input.tensor);
  check_other_arrays(tape, *model, given, inputs);
}

// ErrorKind::Runtime: a scalar of the model has changed since the recording, so that the step would
// run with the new value.
void RecordedStep::check_numbers() const {
  const auto check = [](const char* name, float then, float now) {
    require(then == now, ErrorKind::Runtime, kName, ": model.", name,
            " was set to another value after recording: it was ", then, ", it is ", now);
  };
  check("soft_contact_ke", soft_contact_ke, model->soft_contact_ke);
  check("soft_contact_kd", soft_contact_kd, model->soft_contact_kd);
  check("soft_contact_mu", soft_contact_mu, model->soft_contact_mu);
}

// ErrorKind::NotImplemented: implicit gradients in a capture on a device. They need decisions of
// the host.
void RecordedStep::check_capture() const {
  require(!implicit || !on_device() || nova::current_capture() == nullptr,
          ErrorKind::NotImplemented, kName,
          ": gradient: expected \"unrolled\" inside a ScopedCapture on ", model->device().str(),
          ", got \"implicit\", for which the host decides how far to go");
}

VbdStepInputs RecordedStep::inputs() const {
  check_numbers();
  return {.q = array_of(q),
          .qd = array_of(qd),
          .f = array_of(f),
          .activations = activations,
          .contacts = contacts.get(),
          .targets = targets.defined() ? array_of(part_of(targets, first_target, target_count))
                                       : DeviceArray<Vec3f>(),
          .dt = dt,
          .last_velocity =
              last.defined()
                  ? DeviceArray<Vec4f>(Array(novaphy::DType::vec4,
                                             static_cast<size_t>(last.size() / 4), 1, last.range()))
                  : DeviceArray<Vec4f>(),
          .trains_elements = trains_elements};
}

// Returns the tensors that forward() reads.
std::vector<Tensor> RecordedStep::reads() const {
  std::vector<Tensor> all;
  for (const Input& input : differentiable()) all.push_back(input.tensor);
  all.push_back(Tensor::view(model->particle_inv_mass));
  if (contacts != nullptr)
    ContactFields::visit(static_cast<const ContactFields&>(*contacts), [&](const FieldInfo& info,
                                                                           const Array& array) {
      if (std::string_view(info.name).starts_with("soft_") && array.rows() != 0)
        all.push_back(Tensor::view(array));
    });
  return all;
}

template <class Run>
decltype(auto) RecordedStep::named(const Run& run) const {
  return of_rollout < 0 ? run() : named_step(of_rollout, run);
}

void RecordedStep::capture(std::vector<Tensor> reads, std::vector<Tensor> results,
                           std::function<void()> run) const {
  nova::capture_host_work({.name = kName,
                           .reads = std::move(reads),
                           .results = std::move(results),
                           .failure = failure.get(),
                           .run = std::move(run)});
}

void RecordedStep::forward() {
  check_capture();
  const nova::NoGrad no_grad;
  if (!on_device())  // forward() runs without a recorder on the CPU
    for (DeviceArray<Vec3f>* const written : {&q_out, &qd_out}) written->mutable_data();
  steps->forward(inputs(), q_out, qd_out, in_use);
}

void RecordedStep::submit_forward(const std::shared_ptr<RecordedStep>& step) {
  if (!in_a_capture_of_the_host(*step)) return step->forward();
  const std::vector<Tensor> results = {tensor_of(nova::operand_of(step->q_out)),
                                       tensor_of(nova::operand_of(step->qd_out))};
  step->capture(step->reads(), results, [step] {
    step->named([&] { step->steps->forward(step->inputs(), step->q_out, step->qd_out); });
  });
}

// Runs the backward pass. Returns the requested derivatives, in the order of the inputs.
std::vector<Array> RecordedStep::derivatives(std::span<const Tensor> outputs,
                                             std::span<const nova::InputGradient> to,
                                             bool record) const {
  const std::vector<Input> all = differentiable();
  VbdStepDerivatives gradients;
  std::vector<Array> values(all.size());
  for (size_t k = 0; k < all.size(); ++k) {
    if (!to[k].wanted() && !(record && k < kAlways)) continue;
    const UntrackedScope untracked;
    values[k] = Array(novaphy::DType::float32, all[k].size(*this), model->device());
    gradients.*all[k].derivative = values[k];
  }
  steps->backward(inputs(), array_of(outputs[0]), array_of(outputs[1]), gradients, in_use);
  if (implicit) report.note(steps->info());
  return values;
}

void RecordedStep::backward(std::span<const Tensor> outputs,
                            std::span<const nova::InputGradient> to) const {
  check_capture();
  const nova::NoGrad no_grad;
  AdjointRecord* const record = AdjointRecord::current();
  const std::vector<Array> values = derivatives(outputs, to, record != nullptr);
  if (record != nullptr) add_to(*record, outputs, values);
  const std::vector<Input> all = differentiable();
  for (size_t k = 0; k < all.size(); ++k) {
    if (!to[k].wanted()) continue;
    nova::InputGradient where = to[k];
    if (all[k].is_targets) {  // keeps the gradients of other steps' targets
      if (!where.add) where.put({});
      where = {part_of(where.grad, first_target, target_count), true};
    }
    where.put(Tensor(values[k].range(), where.grad.shape(), nova::DType::F32));
  }
}

// Like backward(), within a replay. The function writes the gradients directly, because nothing
// else writes them during a replay.
void RecordedStep::add_backward(std::span<const Tensor> outputs,
                                std::span<const nova::InputGradient> to) const {
  const std::vector<Array> values = derivatives(outputs, to);
  const std::vector<Input> all = differentiable();
  for (size_t k = 0; k < all.size(); ++k) {
    if (!to[k].wanted()) continue;
    const auto* const value = static_cast<const float*>(values[k].raw());
    auto* grad = static_cast<float*>(to[k].grad.range()->data());
    if (!to[k].add) std::fill_n(grad, to[k].grad.size(), 0.0f);
    if (all[k].is_targets) grad += 3 * first_target;
    for (size_t i = 0; i < values[k].rows(); ++i)
      grad[i] = to[k].add || all[k].is_targets ? grad[i] + value[i] : value[i];
  }
}

void RecordedStep::submit_backward(const std::shared_ptr<RecordedStep>& step,
                                   std::span<const Tensor> outputs,
                                   std::span<const nova::InputGradient> to) {
  if (!in_a_capture_of_the_host(*step)) return step->named([&] { step->backward(outputs, to); });
  std::vector<Tensor> reads = step->reads(), results;
  for (const Tensor& output : outputs) reads.push_back(output);
  for (const nova::InputGradient& gradient : to)
    if (gradient.wanted()) results.push_back(gradient.grad);
  step->capture(std::move(reads), std::move(results),
                [step, from = std::vector(outputs.begin(), outputs.end()),
                 all = std::vector(to.begin(), to.end())] {
                  step->named([&] { step->add_backward(from, all); });
                });
}

std::array<DeviceArray<Vec3f>, 2> RecordedStep::tangents(std::span<const Tensor> tangents) const {
  const std::vector<Input> all = differentiable();
  VbdStepDerivatives direction;
  for (size_t k = 0; k < all.size(); ++k)
    if (tangents[k].defined())
      direction.*all[k].derivative =
          Array(novaphy::DType::float32, all[k].size(*this), 1,
                (all[k].is_targets ? part_of(tangents[k], first_target, target_count) : tangents[k])
                    .range());
  std::array<DeviceArray<Vec3f>, 2> found;
  for (DeviceArray<Vec3f>& rows : found) {
    const UntrackedScope untracked;
    rows = DeviceArray<Vec3f>(static_cast<size_t>(model->particle_count()), model->device());
  }
  AdjointRecord::Step* const entry = AdjointRecord::entry_of(this);
  const std::vector<int32_t> held = entry != nullptr ? held_rows(*entry) : std::vector<int32_t>();
  steps->tangent(inputs(), direction, found[0], found[1], held);
  if (implicit) report.note(steps->info());
  if (entry != nullptr) note_changes(*entry, held);
  return found;
}

void RecordedStep::submit_tangent(const std::shared_ptr<RecordedStep>& step,
                                  std::span<const Tensor> tangents,
                                  std::span<const Tensor> outputs) {
  if (in_a_capture_of_the_host(*step)) {
    std::vector<Tensor> reads = step->reads();
    for (const Tensor& tangent : tangents)
      if (tangent.defined()) reads.push_back(tangent);
    const std::vector results(outputs.begin(), outputs.end());
    return step->capture(std::move(reads), results,
                         [step, results, along = std::vector(tangents.begin(), tangents.end())] {
                           const auto found = step->named([&] { return step->tangents(along); });
                           for (size_t k = 0; k < 2; ++k)
                             std::copy_n(found[k].data(), found[k].rows(),
                                         static_cast<Vec3f*>(results[k].range()->data()));
                         });
  }
  require(nova::current_capture() == nullptr, ErrorKind::NotImplemented, kName,
          ": expected jvp outside a ScopedCapture on ", step->model->device().str(),
          ", because the host sets its directions");
  const nova::NoGrad no_grad;
  const auto found = step->named([&] { return step->tangents(tangents); });
  for (size_t k = 0; k < 2; ++k)
    nova::InputGradient{outputs[k], false}.put(
        Tensor(found[k].range(), outputs[k].shape(), nova::DType::F32));
}

}  // namespace novaphy::diff
