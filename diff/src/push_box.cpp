#include "novaphy/diff/push_box.h"

#include <array>
#include <cmath>
#include <memory>
#include <span>
#include <string>

#include "novaphy/core/device_kernel.h"
#include "novaphy/core/error.h"
#include "novaphy/diff/engine_kernels.h"
#include "novaphy/nova/host_work.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"
#include "push_box_kernels.h"

namespace novaphy::diff {

using nova::Access;
using nova::DType;
using nova::Real;
using nova::Tensor;
using nova::TraceContext;

namespace {

constexpr size_t kInputs = 4 + kPushBoxConstants;
using Inputs = std::array<Tensor, kInputs>;  // pusher_x, pusher_v, box_x, box_v, numbers

struct NumberInfo {
  const char* name;
  PushBoxConstant PushBoxParameters::*member;
  bool positive;
};
constexpr NumberInfo kNumbers[kPushBoxConstants] = {
    {"mass", &PushBoxParameters::mass, true},
    {"half_extent", &PushBoxParameters::half_extent, false},
    {"pusher_radius", &PushBoxParameters::pusher_radius, false},
    {"ke", &PushBoxParameters::ke, false},
    {"kd", &PushBoxParameters::kd, false},
    {"friction", &PushBoxParameters::friction, false},
    {"dt", &PushBoxParameters::dt, true},
    {"softness", &PushBoxParameters::softness, true},
    {"friction_velocity", &PushBoxParameters::friction_velocity, true},
    {"gravity", &PushBoxParameters::gravity, false}};

void check_rows(const Tensor& tensor, int64_t rows, const char* op, const char* name) {
  require(tensor.defined() && tensor.dtype() == DType::F32, ErrorKind::Type, op, ", ", name,
          ": expected a float32 tensor");
  require(tensor.ndim() == 1 && tensor.size() == rows, ErrorKind::Value, op, ", ", name,
          ": expected {", rows, "}, got ", nova::shape_str(tensor.shape()));
}

// Returns the values if the host can read them now, else nothing.
std::span<const float> values_of(const Tensor& tensor) {
  if (!nova::host_can_read(tensor.device())) return {};
  return {tensor.data<float>(), static_cast<size_t>(tensor.size())};
}

void check_states(const Tensor& tensor, const char* op, const char* name) {
  for (const float value : values_of(tensor))
    require(std::isfinite(value), ErrorKind::Value, op, ", ", name,
            ": expected finite numbers, got ", value);
}

void check_number(float value, const NumberInfo& info, const char* op) {
  require(std::isfinite(value) && (info.positive ? value > 0.0f : value >= 0.0f), ErrorKind::Value,
          op, ", ", info.name, ": expected a finite number ", info.positive ? "> 0" : ">= 0",
          ", got ", value);
}

Tensor number_tensor(const PushBoxParameters& parameters, const NumberInfo& info, Device device,
                     const char* op) {
  const PushBoxConstant& number = parameters.*info.member;
  if (const auto* tensor = std::get_if<Tensor>(&number)) {
    check_rows(*tensor, 1, op, info.name);
    for (const float value : values_of(*tensor)) check_number(value, info, op);
    return *tensor;
  }
  const float value = std::get<float>(number);
  check_number(value, info, op);
  return Tensor::full({1}, value, device);
}

Inputs inputs_of(const Tensor& box_x, const Tensor& box_v, const Tensor& pusher_x,
                 const Tensor& pusher_v, const PushBoxParameters& parameters, int64_t steps,
                 const char* op) {
  check_rows(box_x, 1, op, "box_x");
  check_rows(box_v, 1, op, "box_v");
  check_rows(pusher_x, steps, op, "pusher_x");
  check_rows(pusher_v, steps, op, "pusher_v");
  Inputs in = {pusher_x, pusher_v, box_x, box_v};
  for (size_t k = 0; k < kPushBoxConstants; ++k)
    in[4 + k] = number_tensor(parameters, kNumbers[k], box_x.device(), op);
  const char* const names[4] = {"pusher_x", "pusher_v", "box_x", "box_v"};
  for (size_t k = 0; k < 4; ++k) check_states(in[k], op, names[k]);
  for (size_t k = 0; k < kInputs; ++k)
    require(in[k].device() == box_x.device(), ErrorKind::Value, op, ", ",
            k < 4 ? names[k] : kNumbers[k - 4].name, ": expected device ", box_x.device().str(),
            ", got ", in[k].device().str());
  return in;
}

nova::Kernel make_step_kernel() {
  std::vector<nova::SourceSpec> sources;
  for (const char* name : {"pusher_x", "pusher_v", "box_x", "box_v"})
    sources.push_back({name, DType::F32, 1, Access::Direct});
  for (const NumberInfo& info : kNumbers)
    sources.push_back({info.name, DType::F32, 1, Access::Direct});
  const nova::Kernel kernel = nova::make_kernel(
      "integrate_push_box", sources, {{"box_x", 1, "box_x"}, {"box_v", 1, "box_v"}},
      [](TraceContext& c) {
        const PushBoxConstants<Real> n = {c.f32(4), c.f32(5),  c.f32(6),  c.f32(7),  c.f32(8),
                                          c.f32(9), c.f32(10), c.f32(11), c.f32(12), c.f32(13)};
        const PushBoxState<Real> box =
            push_box_step<Real>({c.f32(2), c.f32(3)}, {c.f32(0), c.f32(1)}, n);
        return std::vector<Real>{box.x, box.v};
      });
  return nova::with_one_gradient_set(kernel);
}

const nova::Kernel& step_kernel() {
  static const nova::Kernel kernel = make_step_kernel();
  return kernel;
}

const Kernel<PushBoxRolloutArguments>& rollout_kernel() {
  static const Kernel<PushBoxRolloutArguments> kernel(push_box_rollout, nullptr);
  return kernel;
}
const Kernel<PushBoxRolloutVjpArguments>& rollout_vjp_kernel() {
  static const Kernel<PushBoxRolloutVjpArguments> kernel(push_box_rollout_vjp, nullptr);
  return kernel;
}

struct Rollout {
  Inputs in;
  Tensor x, v;
  int64_t steps = 0;
};

// Returns the tensor's memory. An undefined tensor gives no rows.
DeviceArray<float> floats_of(const Tensor& tensor) {
  if (!tensor.defined()) return {};
  const auto size = static_cast<size_t>(tensor.size());
  return DeviceArray<float>(Array(novaphy::DType::float32, size, 1, tensor.range()));
}

// The inputs as arrays that stay alive as long as a launch.
struct InputArrays {
  DeviceArray<float> states[4], numbers[kPushBoxConstants];

  explicit InputArrays(const Inputs& in) {
    for (size_t k = 0; k < 4; ++k) states[k] = floats_of(in[k]);
    for (size_t k = 0; k < kPushBoxConstants; ++k) numbers[k] = floats_of(in[4 + k]);
  }
  PushBoxArguments arguments(int64_t steps) const {
    return {.pusher_x = states[0],
            .pusher_v = states[1],
            .box_x = states[2],
            .box_v = states[3],
            .numbers = numbers,
            .steps = steps};
  }
};

void run_forward(const Rollout& r) {
  const nova::NoGrad no_grad;
  const InputArrays in(r.in);
  const DeviceArray<float> x = floats_of(r.x), v = floats_of(r.v);
  run(rollout_kernel(), 1, {.in = in.arguments(r.steps), .x = x, .v = v});
}

void run_vjp(const Rollout& r, std::span<const Tensor> outputs,
             std::span<const nova::InputGradient> gradients) {
  const nova::NoGrad no_grad;
  const InputArrays in(r.in);
  const DeviceArray<float> x = floats_of(r.x), v = floats_of(r.v);
  const DeviceArray<float> x_adjoint = floats_of(outputs[0]), v_adjoint = floats_of(outputs[1]);
  DeviceArray<float> gradient[kInputs];
  int64_t add = 0;
  for (size_t k = 0; k < kInputs; ++k) {
    gradient[k] = floats_of(gradients[k].grad);
    if (gradients[k].add) add |= int64_t{1} << k;
  }
  run(rollout_vjp_kernel(), 1,
      {.in = in.arguments(r.steps),
       .x = x,
       .v = v,
       .x_adjoint = x_adjoint,
       .v_adjoint = v_adjoint,
       .gradient = gradient,
       .add = add});
}

// Computes the tangents on the host.
void run_jvp(const Rollout& r, std::span<const Tensor> t, std::span<const Tensor> tangents) {
  const auto tangent = [&](size_t k, int64_t row) {
    return t[k].defined() ? t[k].data<float>()[row] : 0.0f;
  };
  const auto value = [&](size_t k) { return *r.in[k].data<float>(); };
  const PushBoxConstants<float> numbers = {value(4), value(5),  value(6),  value(7),  value(8),
                                           value(9), value(10), value(11), value(12), value(13)};
  PushBoxState<float> box = {value(2), value(3)}, dot = {tangent(2, 0), tangent(3, 0)};
  const auto put = [&](size_t k, int64_t row, float number) {
    if (tangents[k].defined()) static_cast<float*>(tangents[k].range()->data())[row] = number;
  };
  for (int64_t row = 0; row < r.steps; ++row) {
    const PushBoxDerivatives<float> d = push_box_derivatives(
        box, {r.in[0].data<float>()[row], r.in[1].data<float>()[row]}, numbers);
    float by[kPushBoxConstants];
    push_box_list(d.numbers, by);
    float of_v = d.box.x * dot.x + d.box.v * dot.v + d.pusher.x * tangent(0, row) +
                 d.pusher.v * tangent(1, row);
    for (size_t k = 0; k < kPushBoxConstants; ++k) of_v += by[k] * tangent(4 + k, 0);
    box = {r.x.data<float>()[row], r.v.data<float>()[row]};
    dot = {dot.x + (tangent(10, 0) * box.v + numbers.dt * of_v), of_v};
    put(0, row, dot.x);
    put(1, row, dot.v);
  }
}

// Computes the tangents now, or in the replays of a capture.
void submit_jvp(const std::shared_ptr<const Rollout>& rollout, std::span<const Tensor> inputs,
                std::span<const Tensor> outputs) {
  if (!nova::current_capture()) return run_jvp(*rollout, inputs, outputs);
  const std::vector<Tensor> t(inputs.begin(), inputs.end()), out(outputs.begin(), outputs.end());
  std::vector<Tensor> reads(rollout->in.begin(), rollout->in.end());
  reads.insert(reads.end(), t.begin(), t.end());
  reads.insert(reads.end(), {rollout->x, rollout->v});
  nova::capture_host_work(
      {.name = "push_box_rollout", .reads = reads, .results = out, .run = [rollout, t, out] {
         run_jvp(*rollout, t, out);
       }});
}

nova::CustomOp make_op(const std::shared_ptr<const Rollout>& rollout) {
  nova::CustomOp op{.name = "push_box_rollout",
                    .inputs = {rollout->in.begin(), rollout->in.end()},
                    .outputs = {rollout->x, rollout->v},
                    .vjp = nullptr};
  op.reads = op.inputs;
  op.reads.push_back(rollout->x);
  op.reads.push_back(rollout->v);
  op.vjp = [rollout](std::span<const Tensor> outputs, std::span<const nova::InputGradient> inputs) {
    run_vjp(*rollout, outputs, inputs);
  };
  op.forward = [rollout] { run_forward(*rollout); };
  op.jvp = [rollout](std::span<const Tensor> inputs, std::span<const Tensor> outputs) {
    submit_jvp(rollout, inputs, outputs);
  };
  return op;
}

}  // namespace

void detail::add_push_box_kernels(std::vector<nova::EngineKernel>& list) {
  list.push_back({step_kernel(), step_kernel().gradients()});
}

std::pair<Tensor, Tensor> integrate_push_box_generated(const Tensor& box_x, const Tensor& box_v,
                                                       const Tensor& pusher_x,
                                                       const Tensor& pusher_v,
                                                       const PushBoxParameters& parameters) {
  const Inputs in =
      inputs_of(box_x, box_v, pusher_x, pusher_v, parameters, 1, "integrate_push_box_generated");
  const std::vector<Tensor> out = step_kernel()(1, in);
  return {out[0].reshape({1}), out[1].reshape({1})};
}

std::pair<Tensor, Tensor> integrate_push_box_rollout_generated(
    const Tensor& box_x, const Tensor& box_v, const Tensor& pusher_x, const Tensor& pusher_v,
    const PushBoxParameters& parameters) {
  const char* op = "integrate_push_box_rollout_generated";
  require(pusher_x.defined() && pusher_x.size() > 0, ErrorKind::Value, op,
          ", pusher_x: expected {n} with n > 0, a row per step");
  const int64_t steps = pusher_x.size();
  auto rollout = std::make_shared<Rollout>();
  rollout->in = inputs_of(box_x, box_v, pusher_x, pusher_v, parameters, steps, op);
  const Device device = box_x.device();
  require_cpu(device, op, ", box_x: elsewhere take integrate_push_box_generated step by step");
  rollout->x = Tensor({steps}, DType::F32, device);
  rollout->v = Tensor({steps}, DType::F32, device);
  rollout->steps = steps;
  run_forward(*rollout);
  if (nova::Tape* tape = nova::Tape::active()) tape->record_custom(make_op(rollout));
  return {rollout->x, rollout->v};
}

}  // namespace novaphy::diff
