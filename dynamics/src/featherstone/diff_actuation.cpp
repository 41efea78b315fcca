// Actuators and gravity compensation as operations of a tape.
#include "diff_articulation_parts.h"

namespace novaphy::diff::detail {
namespace {

namespace art = articulation;

// A gradient as an argument; null where nobody wants it. What is added to is there then.
Untyped gradient_of(const nova::InputGradient& to) {
  if (!to.wanted()) return Untyped(nullptr);
  if (!to.add) nova::submit_fill(to.grad.range(), 0.0f);
  return argument(to.grad);
}

// The tensors of the arrays that have rows, and the place of each array among them; -1: it has no
// rows.
struct Rows {
  std::vector<Tensor> tensors;
  std::vector<int32_t> place;
  template <class Arrays>
  explicit Rows(const Arrays& arrays) {
    for (const Array& array : arrays) {
      place.push_back(array.rows() == 0 ? -1 : static_cast<int32_t>(tensors.size()));
      if (array.rows() > 0) tensors.push_back(tensor_of(array));
    }
  }
  template <class T>
  T of(std::span<const T> values, size_t array) const {
    return place[array] < 0 ? T{} : values[static_cast<size_t>(place[array])];
  }
};

void record(nova::CustomOp op) {
  op.reads = op.inputs;
  {
    const nova::NoGrad no_grad;
    op.forward();
  }
  if (nova::Tape* tape = nova::Tape::active()) tape->record_custom(std::move(op));
}

void submit_drives(const std::shared_ptr<const Actuators>& actuators, const Model& model,
                   const ActuationArrays& inputs,
                   const std::array<Array, art::kActuationOutputs>& outputs, float dt) {
  const int64_t dofs = model.joint_dof_count();
  const Rows in(inputs), out(outputs);
  const auto arguments = [actuators, owner = model.shared_from_this(), inputs, dt] {
    return actuators->arguments(*owner, inputs, dt);
  };
  constexpr size_t kIn = art::kActuationInputs, kOut = art::kActuationOutputs;
  record({.name = "actuation",
          .inputs = in.tensors,
          .outputs = out.tensors,
          .vjp =
              [=](std::span<const Tensor> g, std::span<const nova::InputGradient> gradients) {
                const nova::NoGrad no_grad;
                run(actuation_kernels().vjp, dofs,
                    {.in = arguments(),
                     .out = each<kOut>([&](size_t i) { return argument(out.of(g, i)); }),
                     .gradient =
                         each<kIn>([&](size_t i) { return gradient_of(in.of(gradients, i)); })});
              },
          .forward =
              [=] {
                run(actuation_kernels().forward, dofs,
                    {.in = arguments(),
                     .out = each<kOut>([&](size_t i) { return Untyped(outputs[i]); })});
              },
          .jvp =
              [=](std::span<const Tensor> t, std::span<const Tensor> tangents) {
                const nova::NoGrad no_grad;
                run(actuation_kernels().jvp, dofs,
                    {.in = arguments(),
                     .tangent = each<kIn>([&](size_t i) { return argument(in.of(t, i)); }),
                     .out = each<kOut>([&](size_t i) {
                       const Tensor to = out.of(tangents, i);
                       if (to.defined()) nova::submit_fill(to.range(), 0.0f);
                       return argument(to);
                     })});
              }});
}

void submit_lift(const Model& model, const Array& body_f, const Array& sum) {
  const int64_t bodies = model.body_count();
  const auto inputs = [owner = model.shared_from_this(), body_f] {
    return gravcomp_inputs(*owner, body_f);
  };
  record({.name = "gravity_compensation",
          .inputs = {tensor_of(model.body_gravcomp), tensor_of(model.body_mass),
                     tensor_of(model.gravity), tensor_of(body_f)},
          .outputs = {tensor_of(sum)},
          .vjp =
              [=](std::span<const Tensor> g, std::span<const nova::InputGradient> gradients) {
                if (!g[0].defined()) return;
                const nova::NoGrad no_grad;
                run(actuation_kernels().lift_vjp, 1,
                    {.in = inputs(),
                     .out = argument(g[0]),
                     .gravcomp = gradient_of(gradients[0]),
                     .mass = gradient_of(gradients[1]),
                     .gravity = gradient_of(gradients[2]),
                     .body_f = gradient_of(gradients[3]),
                     .bodies = bodies});
              },
          .forward =
              [=] { run(actuation_kernels().lift, bodies, {.in = inputs(), .out = Untyped(sum)}); },
          .jvp =
              [=](std::span<const Tensor> t, std::span<const Tensor> tangents) {
                if (!tangents[0].defined()) return;
                const nova::NoGrad no_grad;
                run(actuation_kernels().lift_jvp, bodies,
                    {.in = inputs(),
                     .out = argument(tangents[0]),
                     .gravcomp = argument(t[0]),
                     .mass = argument(t[1]),
                     .gravity = argument(t[2]),
                     .body_f = argument(t[3])});
              }});
}

}  // namespace

ActuatedInputs submit_actuation(const std::shared_ptr<const Actuators>& actuators, const Model& m,
                                const SimState& in, const SimState& out, const Control* control,
                                const nova::Operand& body_f, float dt, StepScratch scratch) {
  ActuatedInputs result = {drives_of(m, control), body_f};
  if (actuators->any()) {
    std::copy_n(scratch.begin(), result.drives.size(), result.drives.begin());
    std::array<Array, art::kActuationOutputs> outputs;
    std::copy_n(scratch.begin(), result.drives.size(), outputs.begin());
    outputs[art::kNextActivation] = out.act;
    submit_drives(actuators, m, Actuators::inputs(m, in, control), outputs, dt);
    scratch = scratch.subspan(result.drives.size());
  }
  if (actuators->lifts()) {
    const Array& sum = scratch[0];
    submit_lift(m, Array(novaphy::DType::spatial_vector, sum.rows(), 1, body_f.range), sum);
    result.body_f = nova::operand_of(sum);
  }
  return result;
}

}  // namespace novaphy::diff::detail
