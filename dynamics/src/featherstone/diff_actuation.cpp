// Actuators, gravity compensation and the fluid as operations of a tape.
#include "body_actuators.h"
#include "diff_articulation_parts.h"
#include "tangent_launches.h"

namespace novaphy::diff::detail {
namespace {

namespace art = articulation;

// Returns a gradient as an argument. Null: not requested. If the gradient has no earlier terms, it
// is set to zero first.
Untyped gradient_of(const nova::InputGradient& to) {
  if (!to.wanted()) return Untyped(nullptr);
  if (!to.add) nova::submit_fill(to.grad.range(), 0.0f);
  return argument(to.grad);
}

// The tensors of the arrays that have rows, and the index of each array's tensor. -1: no rows.
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

// The wrenches of actuators on bodies and of the fluid in a step, as an operation of a tape.
class Push {
 public:
  static constexpr size_t kFirstOfFluid = kPushingInputs + 4, kOfWorlds = 3;
  Push(const std::shared_ptr<const Actuators>& actuators, const Model& m, const SimState& state,
       const Control* control, const Array& body_f, const Array& sum)
      : bodies_(actuators->on_bodies()),
        model_(m.shared_from_this()),
        inputs_(Actuators::inputs(m, state, control)),
        flows_(actuators->flows()),
        q_(state.joint_q),
        qd_(state.joint_qd),
        body_f_(body_f),
        sum_(sum) {}

  // Returns the kPushingInputs arrays, then body_f, q, qd and body_com, then the arrays of the
  // fluid.
  std::vector<Array> arrays() const {
    std::vector<Array> all(inputs_.begin() + art::kActuated, inputs_.end());
    for (const Array& array :
         {Array(model_->actuator_wrench), body_f_, q_, qd_, Array(model_->body_com)})
      all.push_back(array);
    for (const Array& array : fluid_arrays(*model_))
      if (flows_) all.push_back(array);
    return all;
  }
  void forward() const {
    run(body_actuation_kernels().forward, trees(),
        {.in = arguments(), .body_f = Untyped(body_f_), .out = Untyped(sum_)});
  }
  // Runs the adjoint. to(i) returns the gradient by array i. `ordered`: some arrays belong to
  // worlds, so that a fixed order of sums needs one kernel row.
  template <class To>
  void vjp(const Tensor& gradient, bool ordered, const To& to) const {
    const auto& memory = bodies_->adjoint_memory().range();
    const size_t poses = 7 * sum_.rows() * sizeof(float), motions = poses / 7 * 6;
    run(body_actuation_kernels().vjp, ordered ? 1 : trees(),
        {.in = arguments(),
         .out = argument(gradient),
         .gradient = each<kPushingInputs>(to),
         .fluid = of_fluid(to),
         .q = to(kPushingInputs + 1),
         .qd = to(kPushingInputs + 2),
         .com = to(kPushingInputs + 3),
         .body_f = to(kPushingInputs),
         .poses = nova::part_of(memory, 0, poses),
         .motions = nova::part_of(memory, poses, motions),
         .trees = ordered ? trees() : 1});
  }
  // Runs the tangent. tangent(i) returns the tangent of array i.
  template <class Of>
  void jvp(const Tensor& to, const Of& tangent) const {
    const BodyActuators& all = *bodies_;
    const auto memory = [&](int64_t numbers) {
      const UntrackedScope untracked;
      return DeviceArray<float>(static_cast<size_t>(numbers), model_->device());
    };
    std::vector<DeviceArray<float>> duals;  // dual numbers of the arrays that the trees read
    const auto take = [&](const Array& array) {
      const std::pair<const Array&, size_t> moving[] = {{q_, 1}, {qd_, 2}, {model_->body_com, 3}};
      Tensor along;
      for (const auto& [of, place] : moving)
        if (of.range() == array.range()) along = tangent(kPushingInputs + place);
      const auto numbers = static_cast<int64_t>(array.bytes() / sizeof(float));
      duals.push_back(memory(2 * numbers));
      run(tangent_kernels().pack, numbers,
          {.values = Untyped(array), .tangents = argument(along), .to = Untyped(duals.back())});
      return Untyped(duals.back());
    };
    const DeviceArray<float> workspace = memory(trees() * all.stride<DualFloat>());
    run(body_actuation_kernels().jvp, trees(),
        {.in = all.arguments<DualFloat>(*model_, inputs_, flows_, q_, qd_, workspace, take),
         .tangent = each<kPushingInputs>([&](size_t i) { return argument(tangent(i)); }),
         .fluid = of_fluid([&](size_t i) { return argument(tangent(i)); }),
         .body_f = argument(tangent(kPushingInputs)),
         .out = argument(to)});
  }

 private:
  // Returns take(i) for each array i of the fluid.
  template <class Take>
  auto of_fluid(const Take& take) const {
    return each<art::kFluidInputs>(
        [&](size_t i) { return flows_ ? take(kFirstOfFluid + i) : Untyped(nullptr); });
  }
  int64_t trees() const { return bodies_->count(); }
  BodyActuationOf<float> arguments() const {
    return bodies_->arguments<float>(*model_, inputs_, flows_, q_, qd_, bodies_->workspace(),
                                     [](const Array& array) { return Untyped(array); });
  }

  std::shared_ptr<const BodyActuators> bodies_;
  std::shared_ptr<const Model> model_;
  ActuationArrays inputs_;
  bool flows_;
  Array q_, qd_, body_f_, sum_;
};

void submit_push(const Push& push, const Array& sum) {
  const Rows in(push.arrays());
  record({.name = "body_actuation",
          .inputs = in.tensors,
          .outputs = {tensor_of(sum)},
          .vjp =
              [=](std::span<const Tensor> g, std::span<const nova::InputGradient> gradients) {
                if (!g[0].defined()) return;
                const nova::NoGrad no_grad;
                bool ordered = false;
                for (size_t i = Push::kFirstOfFluid; i < in.place.size(); ++i)
                  ordered = ordered || (i < Push::kFirstOfFluid + Push::kOfWorlds &&
                                        in.of(gradients, i).wanted());
                push.vjp(g[0], ordered, [&](size_t i) { return gradient_of(in.of(gradients, i)); });
              },
          .forward = [=] { push.forward(); },
          .jvp =
              [=](std::span<const Tensor> t, std::span<const Tensor> tangents) {
                if (!tangents[0].defined()) return;
                const nova::NoGrad no_grad;
                push.jvp(tangents[0], [&](size_t i) { return in.of(t, i); });
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
  const auto wrenches = [&] {
    return Array(novaphy::DType::spatial_vector, static_cast<size_t>(m.body_count()), 1,
                 result.body_f.range);
  };
  if (actuators->on_bodies() != nullptr) {
    submit_push({actuators, m, in, control, wrenches(), scratch[0]}, scratch[0]);
    result.body_f = nova::operand_of(scratch[0]);
    scratch = scratch.subspan(1);
  }
  if (actuators->lifts()) {
    submit_lift(m, wrenches(), scratch[0]);
    result.body_f = nova::operand_of(scratch[0]);
  }
  return result;
}

}  // namespace novaphy::diff::detail
