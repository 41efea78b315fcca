#include "diff_vbd_step.h"

#include <algorithm>
#include <string_view>
#include <type_traits>
#include <utility>

#include "novaphy/core/error.h"
#include "novaphy/nova/host_work.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/op_list.h"

namespace novaphy::diff {
namespace {

using nova::Tensor;

const Vec3f* rows_of(const Tensor& tensor) {
  return reinterpret_cast<const Vec3f*>(tensor.data<float>());
}
// Rows of three numbers; without rows where the tensor is not defined.
DeviceArray<Vec3f> array_of(const Tensor& tensor) {
  if (!tensor.defined() || tensor.size() == 0) return {};
  return DeviceArray<Vec3f>(
      Array(novaphy::DType::vec3, static_cast<size_t>(tensor.size() / 3), 1, tensor.range()));
}
// Rows of a tensor, as memory of its own.
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

// Arrays of the model that a step has a gradient by, besides the activations.
#define NOVAPHY_VBD_ELEMENT_INPUTS(X) \
  X(particle_spring_stiffness)        \
  X(particle_spring_damping)          \
  X(particle_spring_rest_length)      \
  X(particle_tri_pose)                \
  X(particle_tri_area)                \
  X(particle_tri_material)            \
  X(particle_edge_material)           \
  X(particle_edge_rest_angle)         \
  X(particle_edge_rest_length)        \
  X(particle_tet_pose)                \
  X(particle_tet_material)
#define NOVAPHY_VBD_MODEL_INPUTS(X) \
  X(gravity)                        \
  X(particle_mass)                  \
  X(particle_radius)                \
  NOVAPHY_VBD_ELEMENT_INPUTS(X)     \
  X(shape_margin)                   \
  X(shape_material_ke)              \
  X(shape_material_kd)              \
  X(shape_material_mu)

std::vector<RecordedStep::Input> RecordedStep::differentiable() const {
  std::vector<Input> all;
  const auto add = [&](const Tensor& tensor, auto bars, auto slopes,
                       Array VbdStepArrays::*array_bars) {
    if constexpr (std::is_same_v<decltype(bars), float * VbdStepGradients::*>) {
      all.push_back({tensor, bars, slopes, nullptr, nullptr, array_bars});
    } else {
      all.push_back({tensor, nullptr, nullptr, bars, slopes, array_bars});
    }
  };
  const Model& m = *model;
#define NOVAPHY_ADD(input, name) \
  add(input, &VbdStepGradients::name, &VbdStepTangents::name, &VbdStepArrays::name)
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
  NOVAPHY_ADD_ARRAY(tri_activation, particle_tri_activation);
  NOVAPHY_ADD_ARRAY(tet_activation, particle_tet_activation);
#define NOVAPHY_ADD_MODEL(name) NOVAPHY_ADD_ARRAY(m.name, name);
  NOVAPHY_VBD_MODEL_INPUTS(NOVAPHY_ADD_MODEL)
#undef NOVAPHY_ADD_MODEL
#undef NOVAPHY_ADD_ARRAY
#undef NOVAPHY_ADD
  return all;
}

bool RecordedStep::trains(const nova::Tape& tape) const {
  if (!on_device() || nova::current_capture() == nullptr) return false;
  const auto carries = [&tape](const Array& array) {
    return array.rows() != 0 && tape.carries_gradient(*array.range());
  };
#define NOVAPHY_CARRIES(name) || carries(model->name)
  return false NOVAPHY_VBD_ELEMENT_INPUTS(NOVAPHY_CARRIES);
#undef NOVAPHY_CARRIES
}

void RecordedStep::check_others(const nova::Tape& tape, const Contacts* given) const {
  const std::vector<Input> all = differentiable();
  const auto check = [&](const char* of, const FieldInfo& info, const Array& array) {
    if (array.rows() == 0 || !tape.carries_gradient(*array.range())) return;
    for (const Input& input : all)
      if (input.tensor.range()->overlaps(*array.range())) return;
    fail(ErrorKind::NotImplemented, kName, ": ", of, ".", info.name,
         ": a step of VBD has no gradient by it; set requires_grad = false there");
  };
  ModelFields::visit(static_cast<const ModelFields&>(*model),
                     [&](const FieldInfo& info, const Array& array) {
                       const std::string_view name = info.name;
                       if (name != "particle_q" && name != "particle_qd")
                         check("model", info, array);
                     });
  if (given != nullptr)
    ContactFields::visit(
        static_cast<const ContactFields&>(*given),
        [&](const FieldInfo& info, const Array& array) { check("contacts", info, array); });
}

// ErrorKind::Runtime when a number was set to another value: the step would run with it.
void RecordedStep::check_numbers() const {
  const auto check = [](const char* name, float then, float now) {
    require(then == now, ErrorKind::Runtime, kName, ": model.", name,
            " was set to another value after recording: it was ", then, ", it is ", now);
  };
  check("soft_contact_ke", soft_contact_ke, model->soft_contact_ke);
  check("soft_contact_kd", soft_contact_kd, model->soft_contact_kd);
  check("soft_contact_mu", soft_contact_mu, model->soft_contact_mu);
}

// ErrorKind::NotImplemented: a capture on a device of what the host decides about.
void RecordedStep::check_capture() const {
  require(!implicit || !on_device() || nova::current_capture() == nullptr,
          ErrorKind::NotImplemented, kName,
          ": gradient: expected \"unrolled\" inside a ScopedCapture on ", model->device().str(),
          ", got \"implicit\", for which the host decides how far to go");
}

VbdStepInputs RecordedStep::inputs() const {
  check_numbers();
  const Vec3f* const to = targets.defined() ? rows_of(targets) + first_target : nullptr;
  const auto* const before =
      last.defined() ? reinterpret_cast<const Vec4f*>(last.data<float>()) : nullptr;
  return {rows_of(q),     rows_of(qd), rows_of(f), &tri_activation, &tet_activation,
          contacts.get(), dt,          to,         before};
}
VbdLaunchInputs RecordedStep::launch_inputs() const {
  check_numbers();
  return {array_of(q),
          array_of(qd),
          array_of(f),
          tri_activation,
          tet_activation,
          contacts.get(),
          targets.defined() ? array_of(part_of(targets, first_target, target_count))
                            : DeviceArray<Vec3f>(),
          dt,
          last.defined()
              ? DeviceArray<Vec4f>(Array(novaphy::DType::vec4, static_cast<size_t>(last.size() / 4),
                                         1, last.range()))
              : DeviceArray<Vec4f>(),
          trains_elements};
}

// What forward reads.
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
  try {
    return run();
  } catch (const Error& error) {
    if (of_rollout < 0) throw;
    fail(error.kind(), "step ", of_rollout, " of the rollout: ", error.what());
  }
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
  if (!on_device()) return steps->forward(inputs(), q_out.mutable_data(), qd_out.mutable_data());
  const nova::NoGrad no_grad;
  steps->forward(launch_inputs(), q_out, qd_out, in_use);
}

void RecordedStep::submit_forward(const std::shared_ptr<RecordedStep>& step) {
  if (!in_a_capture_of_the_host(*step)) return step->named([&] { step->forward(); });
  const std::vector<Tensor> results = {tensor_of(nova::operand_of(step->q_out)),
                                       tensor_of(nova::operand_of(step->qd_out))};
  step->capture(step->reads(), results, [step, results] {
    const auto rows = [](const Tensor& to) { return static_cast<Vec3f*>(to.range()->data()); };
    step->named([&] { step->steps->forward(step->inputs(), rows(results[0]), rows(results[1])); });
  });
}

// The derivatives that are wanted, in the order of the inputs.
std::vector<std::vector<float>> RecordedStep::derivatives(
    std::span<const Tensor> outputs, std::span<const nova::InputGradient> to) const {
  const std::vector<Input> all = differentiable();
  VbdStepGradients gradients;
  std::vector<std::vector<float>> values(all.size());
  for (size_t k = 0; k < all.size(); ++k) {
    if (!to[k].wanted()) continue;
    values[k].resize(all[k].size(*this));
    if (all[k].bars != nullptr) {
      gradients.*all[k].bars = values[k].data();
    } else {
      gradients.*all[k].vector_bars = reinterpret_cast<Vec3f*>(values[k].data());
    }
  }
  steps->backward(inputs(), outputs[0].defined() ? rows_of(outputs[0]) : nullptr,
                  outputs[1].defined() ? rows_of(outputs[1]) : nullptr, gradients);
  return values;
}
// The same on a device.
std::vector<Array> RecordedStep::device_derivatives(std::span<const Tensor> outputs,
                                                    std::span<const nova::InputGradient> to) const {
  const std::vector<Input> all = differentiable();
  VbdStepArrays gradients;
  std::vector<Array> values(all.size());
  for (size_t k = 0; k < all.size(); ++k) {
    if (!to[k].wanted()) continue;
    const Unobserved unobserved;
    values[k] = Array(novaphy::DType::float32, all[k].size(*this), model->device());
    gradients.*all[k].array_bars = values[k];
  }
  steps->backward(launch_inputs(), array_of(outputs[0]), array_of(outputs[1]), gradients, in_use);
  return values;
}

// `value`: the derivative by an input, as a tensor of a shape.
template <class Value>
void RecordedStep::put(std::span<const nova::InputGradient> to, const Value& value) const {
  const std::vector<Input> all = differentiable();
  for (size_t k = 0; k < all.size(); ++k) {
    if (!to[k].wanted()) continue;
    nova::InputGradient where = to[k];
    if (all[k].is_targets) {  // those of the other steps stay
      if (!where.add) where.put({});
      where = {part_of(where.grad, first_target, target_count), true};
    }
    where.put(value(k, where.grad.shape()));
  }
}

void RecordedStep::backward(std::span<const Tensor> outputs,
                            std::span<const nova::InputGradient> to) const {
  check_capture();
  if (on_device()) {
    const nova::NoGrad no_grad;
    const std::vector<Array> values = device_derivatives(outputs, to);
    return put(to, [&](size_t k, const nova::Shape& shape) {
      return Tensor(values[k].range(), shape, nova::DType::F32);
    });
  }
  const std::vector<std::vector<float>> values = derivatives(outputs, to);
  put(to, [&](size_t k, const nova::Shape& shape) {
    return Tensor::from_host(values[k], shape, Device::cpu());
  });
}

// The same, as part of a replay: what lies there is written by nobody else meanwhile.
void RecordedStep::add_backward(std::span<const Tensor> outputs,
                                std::span<const nova::InputGradient> to) const {
  const std::vector<std::vector<float>> values = derivatives(outputs, to);
  const std::vector<Input> all = differentiable();
  for (size_t k = 0; k < all.size(); ++k) {
    if (!to[k].wanted()) continue;
    auto* grad = static_cast<float*>(to[k].grad.range()->data());
    if (!to[k].add) std::fill_n(grad, to[k].grad.size(), 0.0f);
    if (all[k].is_targets) grad += 3 * first_target;
    for (size_t i = 0; i < values[k].size(); ++i)
      grad[i] = to[k].add || all[k].is_targets ? grad[i] + values[k][i] : values[k][i];
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

RecordedStep::Slopes RecordedStep::tangents(std::span<const Tensor> slopes) const {
  const std::vector<Input> all = differentiable();
  VbdStepTangents direction;
  for (size_t k = 0; k < all.size(); ++k) {
    if (!slopes[k].defined()) continue;
    const auto* const first = slopes[k].data<float>() + (all[k].is_targets ? 3 * first_target : 0);
    if (all[k].slopes != nullptr) {
      direction.*all[k].slopes = first;
    } else {
      direction.*all[k].vector_slopes = reinterpret_cast<const Vec3f*>(first);
    }
  }
  const auto n = static_cast<size_t>(model->particle_count());
  Slopes found = {std::vector<Vec3f>(n), std::vector<Vec3f>(n)};
  steps->tangent(inputs(), direction, found[0].data(), found[1].data());
  return found;
}

void RecordedStep::device_tangents(std::span<const Tensor> slopes,
                                   std::span<const Tensor> outputs) const {
  require(nova::current_capture() == nullptr, ErrorKind::NotImplemented, kName,
          ": expected jvp outside a ScopedCapture on ", model->device().str(),
          ", because the host sets its directions");
  const nova::NoGrad no_grad;
  const std::vector<Input> all = differentiable();
  VbdStepArrays direction;
  for (size_t k = 0; k < all.size(); ++k)
    if (slopes[k].defined())
      direction.*all[k].array_bars = Array(
          novaphy::DType::float32, all[k].size(*this), 1,
          (all[k].is_targets ? part_of(slopes[k], first_target, target_count) : slopes[k]).range());
  DeviceArray<Vec3f> found[2];
  for (DeviceArray<Vec3f>& rows : found) {
    const Unobserved unobserved;
    rows = DeviceArray<Vec3f>(static_cast<size_t>(model->particle_count()), model->device());
  }
  steps->tangent(launch_inputs(), direction, found[0], found[1]);
  for (size_t k = 0; k < 2; ++k)
    nova::InputGradient{outputs[k], false}.put(
        Tensor(found[k].range(), outputs[k].shape(), nova::DType::F32));
}

void RecordedStep::submit_tangent(const std::shared_ptr<RecordedStep>& step,
                                  std::span<const Tensor> slopes, std::span<const Tensor> outputs) {
  if (step->on_device()) return step->named([&] { step->device_tangents(slopes, outputs); });
  if (nova::current_capture() == nullptr) {
    const Slopes found = step->named([&] { return step->tangents(slopes); });
    for (size_t k = 0; k < 2; ++k)
      nova::InputGradient{outputs[k], false}.put(Tensor::from_host(
          std::span(&found[k].front().x, 3 * found[k].size()), outputs[k].shape(), Device::cpu()));
    return;
  }
  std::vector<Tensor> reads = step->reads();
  for (const Tensor& slope : slopes)
    if (slope.defined()) reads.push_back(slope);
  const std::vector results(outputs.begin(), outputs.end());
  step->capture(std::move(reads), results,
                [step, results, along = std::vector(slopes.begin(), slopes.end())] {
                  const Slopes found = step->named([&] { return step->tangents(along); });
                  for (size_t k = 0; k < 2; ++k)
                    std::copy(found[k].begin(), found[k].end(),
                              static_cast<Vec3f*>(results[k].range()->data()));
                });
}

}  // namespace novaphy::diff
