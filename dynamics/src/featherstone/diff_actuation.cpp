// Actuators and gravity compensation as operations of a tape.
#include "diff_articulation_parts.h"

namespace novaphy::diff::detail {
namespace {

namespace art = articulation;

// A gradient as a word of a launch; null where nobody wants it. What is added to is there then.
LaunchArgument gradient_word(const nova::InputGradient& to) {
  if (!to.wanted()) return {};
  if (!to.add) nova::submit_fill(to.grad.range(), 0.0f);
  return argument("gradient", to.grad, true);
}
LaunchArgument tangent_word(const Tensor& tensor, bool write = false) {
  return argument("tangent", tensor, write);
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
  const Device device = model.device();
  const Rows in(inputs), out(outputs);
  const auto words = [actuators, owner = model.shared_from_this(), inputs, dt] {
    return actuators->words(*owner, inputs, dt);
  };
  record({.name = "actuation",
          .inputs = in.tensors,
          .outputs = out.tensors,
          .vjp =
              [=](std::span<const Tensor> g, std::span<const nova::InputGradient> gradients) {
                const nova::NoGrad no_grad;
                LaunchWords all = words();
                for (size_t i = 0; i < outputs.size(); ++i)
                  all.push_back(tangent_word(out.of(g, i)));
                for (size_t i = 0; i < inputs.size(); ++i)
                  all.push_back(gradient_word(in.of(gradients, i)));
                actuation_kernels().vjp.launch(device, dofs, all);
              },
          .forward =
              [=] {
                LaunchWords all = words();
                for (const Array& array : outputs)
                  all.push_back(word_of("drives of a step", array, true));
                actuation_kernels().forward.launch(device, dofs, all);
              },
          .jvp =
              [=](std::span<const Tensor> t, std::span<const Tensor> tangents) {
                const nova::NoGrad no_grad;
                LaunchWords all = words();
                for (size_t i = 0; i < inputs.size(); ++i) all.push_back(tangent_word(in.of(t, i)));
                for (size_t i = 0; i < outputs.size(); ++i) {
                  const Tensor to = out.of(tangents, i);
                  if (to.defined()) nova::submit_fill(to.range(), 0.0f);
                  all.push_back(tangent_word(to, true));
                }
                actuation_kernels().jvp.launch(device, dofs, all);
              }});
}

void submit_lift(const Model& model, const Array& body_f, const Array& sum) {
  const int64_t bodies = model.body_count();
  const Device device = model.device();
  const auto owner = model.shared_from_this();
  record({.name = "gravity_compensation",
          .inputs = {tensor_of(model.body_gravcomp), tensor_of(model.body_mass),
                     tensor_of(model.gravity), tensor_of(body_f)},
          .outputs = {tensor_of(sum)},
          .vjp =
              [=](std::span<const Tensor> g, std::span<const nova::InputGradient> gradients) {
                const nova::NoGrad no_grad;
                LaunchWords all = gravcomp_words(*owner, body_f);
                all.push_back(tangent_word(g[0]));
                for (const nova::InputGradient& to : gradients) all.push_back(gradient_word(to));
                if (!g[0].defined()) return;
                all.push_back(number(bodies));
                actuation_kernels().lift_vjp.launch(device, 1, all);
              },
          .forward =
              [=] {
                LaunchWords all = gravcomp_words(*owner, body_f);
                all.push_back(word_of("wrenches of a step", sum, true));
                actuation_kernels().lift.launch(device, bodies, all);
              },
          .jvp =
              [=](std::span<const Tensor> t, std::span<const Tensor> tangents) {
                if (!tangents[0].defined()) return;
                const nova::NoGrad no_grad;
                LaunchWords all = gravcomp_words(*owner, body_f);
                all.push_back(tangent_word(tangents[0], true));
                for (const Tensor& tangent : t) all.push_back(tangent_word(tangent));
                actuation_kernels().lift_jvp.launch(device, bodies, all);
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
