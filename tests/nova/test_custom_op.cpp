// Operations with a custom adjoint, between checkpoints and in captures. The example is pairs of
// bodies on a line, joined by a hardening spring, with a handwritten derivative of the step.
#include <algorithm>
#include <functional>

#include "novaphy/nova/op_list.h"
#include "support.h"
#include "support/threads.h"

namespace novaphy::testing {
namespace {

using nova::CustomOp;
using nova::InputGradient;
using nova::KeepGradients;
using Floats = std::vector<float>;

constexpr float kDt = 0.05f, kStiffness = 3.0f;
constexpr int32_t kSteps = 23;

// Rows (x1, x2, v1, v2); f = k d^3 along d = x2 - x1, with k from a tensor of one value.
const Kernel& step_kernel() {
  static const Kernel kernel = nova::make_kernel(
      "two_bodies",
      {{"state", DType::F32, 4, Access::Direct}, {"stiffness", DType::F32, 1, Access::Uniform}},
      {{"next", 4}}, [](TraceContext& c) {
        const Real d = c.f32(0, 1) - c.f32(0, 0), f = c.f32(1) * (d * d * d) * kDt;
        const Real v1 = c.f32(0, 2) + f, v2 = c.f32(0, 3) - f;
        return std::vector{c.f32(0, 0) + v1 * kDt, c.f32(0, 1) + v2 * kDt, v1, v2};
      });
  return kernel;
}

// (g1, g2, h1, h2) of the next state to those of the state.
const Kernel& vjp_kernel() {
  static const Kernel kernel = nova::make_kernel(
      "two_bodies.vjp",
      {{"state", DType::F32, 4, Access::Direct},
       {"stiffness", DType::F32, 1, Access::Uniform},
       {"g", DType::F32, 4, Access::Direct}},
      {{"gradient", 4}}, [](TraceContext& c) {
        const Real d = c.f32(0, 1) - c.f32(0, 0);
        const Real h1 = c.f32(2, 2) + c.f32(2, 0) * kDt, h2 = c.f32(2, 3) + c.f32(2, 1) * kDt;
        const Real by_d = (h1 - h2) * (c.f32(1) * (d * d) * 3.0f * kDt);
        return std::vector{c.f32(2, 0) - by_d, c.f32(2, 1) + by_d, h1, h2};
      });
  return kernel;
}

// The tangent of the next state.
const Kernel& jvp_kernel() {
  static const Kernel kernel = nova::make_kernel(
      "two_bodies.jvp",
      {{"state", DType::F32, 4, Access::Direct},
       {"stiffness", DType::F32, 1, Access::Uniform},
       {"t", DType::F32, 4, Access::Direct}},
      {{"tangent", 4}}, [](TraceContext& c) {
        const Real d = c.f32(0, 1) - c.f32(0, 0);
        const Real f = (c.f32(2, 1) - c.f32(2, 0)) * (c.f32(1) * (d * d) * 3.0f * kDt);
        const Real v1 = c.f32(2, 2) + f, v2 = c.f32(2, 3) - f;
        return std::vector{c.f32(2, 0) + v1 * kDt, c.f32(2, 1) + v2 * kDt, v1, v2};
      });
  return kernel;
}

void launch(const Kernel& kernel, std::initializer_list<Tensor> inputs, const Tensor& output) {
  std::vector<nova::Operand> in;
  for (const Tensor& t : inputs) in.push_back(t.operand());
  const nova::Operand out = output.operand();
  kernel.launch(output.rows(), in, out);
}

CustomOp two_bodies(const Tensor& state, const Tensor& next, const Tensor& stiffness,
                    const Tensor& scratch) {
  return {.name = "two_bodies",
          .inputs = {state},
          .outputs = {next},
          .vjp =
              [=](std::span<const Tensor> g, std::span<const InputGradient> gradients) {
                launch(vjp_kernel(), {state, stiffness, g[0]}, scratch);
                gradients[0].put(scratch);
              },
          .forward =
              [=] {
                launch(step_kernel(), {state, stiffness}, next);
              },
          .jvp =
              [=](std::span<const Tensor> t, std::span<const Tensor> tangents) {
                launch(jvp_kernel(), {state, stiffness, t[0]}, tangents[0]);
              },
          .reads = {state, stiffness},
          .writes = {scratch}};
}

void step(const CustomOp& op) {
  {
    const NoGrad no;
    op.forward();
  }
  if (Tape* tape = Tape::active()) tape->record_custom(op);
}

// States of a rollout, every interval-th kept, the others in one memory for each place in between.
struct Rollout {
  Rollout(int64_t n, int32_t every) : pairs(n), interval(every) {
    for (int32_t t = 0; t <= kSteps; ++t) {
      const bool shared = t % interval != 0 && t != kSteps && t > interval;
      states.push_back(shared ? states[static_cast<size_t>(t % interval)] : Tensor(Shape{n, 4}));
    }
    Random random(11);
    const Floats start = random.values(4 * n, -1.0f, 1.0f);
    write(states[0], start);
    states[0].set_requires_grad(true);
  }
  CustomOp op(int32_t t) const {
    const auto k = static_cast<size_t>(t);
    return two_bodies(states[k], states[k + 1], stiffness, scratch);
  }
  // The gradient of the sum of squares of the last state.
  void run(KeepGradients keep) {
    Tape tape(keep);
    const TapeScope scope(tape);
    for (int32_t first = 0; first < kSteps; first += interval) {
      const nova::RecomputedScope once_more(interval > 1);
      for (int32_t t = first; t < std::min(first + interval, kSteps); ++t) step(op(t));
    }
    tape.backward(nova::dot(states.back(), states.back()));
  }

  int64_t pairs;
  int32_t interval;
  std::vector<Tensor> states;
  Tensor stiffness = tensor({kStiffness}), scratch{Shape{pairs, 4}};
};

Floats gradient(int64_t pairs, int32_t interval, bool captured = false,
                KeepGradients keep = KeepGradients::All) {
  Rollout rollout(pairs, interval);
  if (captured) {
    nova::ScopedCapture capture;
    rollout.run(keep);
    capture.end();
    capture.graph()->launch();
    rollout.states[0].zero_grad();
    capture.graph()->launch();  // again, from the start
  } else {
    rollout.run(keep);
  }
  return rollout.states[0].grad().to_host();
}

// A tape for each step, from the last one back.
Floats gradient_step_by_step(int64_t pairs) {
  Rollout rollout(pairs, 1);
  for (int32_t t = 0; t < kSteps; ++t) rollout.op(t).forward();
  Tensor seed;
  {
    const NoGrad no;
    seed = nova::mul(rollout.states.back(), 2.0f);
  }
  for (int32_t t = kSteps; t-- > 0;) {
    const Tensor state = rollout.states[static_cast<size_t>(t)];
    state.set_requires_grad(true);
    Tape tape;
    const TapeScope scope(tape);
    tape.record_custom(rollout.op(t));
    tape.backward(rollout.states[static_cast<size_t>(t) + 1], seed);
    seed = state.grad().clone();
  }
  return seed.to_host();
}

class CustomOps : public ::testing::TestWithParam<int64_t> {};

TEST_P(CustomOps, BetweenCheckpointsAndInCapturesHaveTheBitsOfStepByStep) {
  const Floats expected = gradient_step_by_step(GetParam());
  EXPECT_NE(expected, Floats(expected.size(), 0.0f));
  for (const int threads : {1, 2, 7}) {
    const Threads set(threads);
    for (const int32_t interval : {1, 2, 5, kSteps})
      for (const bool captured : {false, true})
        for (const KeepGradients keep : {KeepGradients::All, KeepGradients::Leaves}) {
          SCOPED_TRACE(interval);
          EXPECT_TRUE(same_bits<float>(gradient(GetParam(), interval, captured, keep), expected))
              << (captured ? "captured" : "at once") << ", " << threads << " threads";
        }
  }
}
INSTANTIATE_TEST_SUITE_P(Sizes, CustomOps, ::testing::Values(1, 3, 6001));

TEST(CustomOp, ATapeGoesBackAgainWhereAdjointsReadOutputsThatAreRunOnceMore) {
  Rollout rollout(3, 5);
  Tape tape;
  const TapeScope scope(tape);
  for (int32_t first = 0; first < kSteps; first += rollout.interval) {
    const nova::RecomputedScope once_more(true);
    for (int32_t t = first; t < std::min(first + rollout.interval, kSteps); ++t) {
      CustomOp op = rollout.op(t);
      op.reads.push_back(op.outputs[0]);
      step(op);
    }
  }
  const Tensor loss = nova::dot(rollout.states.back(), rollout.states.back());
  tape.backward(loss);
  Floats expected = rollout.states[0].grad().to_host();
  for (float& x : expected) x *= 2.0f;
  tape.backward(loss);
  EXPECT_TRUE(same_bits<float>(rollout.states[0].grad().to_host(), expected));
  rollout.states[5].fill_(0.5f);  // a kept one
  EXPECT_ERROR(tape.backward(loss), ErrorKind::Runtime, "was modified after recording");
}

TEST(CustomOp, ItsGradientIsThatOfTheGeneratedAdjoint) {
  const Floats got = gradient(3, 5);
  Rollout rollout(3, 1);
  Tape tape;
  const TapeScope scope(tape);
  for (size_t t = 0; t < kSteps; ++t)
    launch(step_kernel(), {rollout.states[t], rollout.stiffness}, rollout.states[t + 1]);
  tape.backward(nova::dot(rollout.states.back(), rollout.states.back()));
  const Floats expected = rollout.states[0].grad().to_host();
  for (size_t k = 0; k < got.size(); ++k)
    EXPECT_NEAR(got[k], expected[k], 1e-5f * std::fabs(expected[k]) + 1e-5f);
}

TEST(CustomOp, ItsTangentIsTheTransposeOfItsGradient) {
  const Rollout rollout(4, 1);
  const CustomOp op = rollout.op(0);
  Random random(3);
  const Tensor u = tensor(random.values(16), {4, 4}), w = tensor(random.values(16), {4, 4});
  const Tensor tangent(Shape{4, 4}), grad(Shape{4, 4});
  op.jvp(std::vector{u}, std::vector{tangent});
  op.vjp(std::vector{w}, std::vector{InputGradient{grad, false}});
  const float forward = nova::dot(tangent, w).item(), backward = nova::dot(u, grad).item();
  EXPECT_NEAR(forward, backward, 1e-5f * std::fabs(forward));
}

TEST(CustomOp, AddsToWhatOtherReadersOfItsInputGave) {
  const Tensor x = tensor({1.0f, 2.0f}, true), y = tensor({0.0f, 0.0f});
  const CustomOp thrice{.name = "thrice",
                        .inputs = {x},
                        .outputs = {y},
                        .vjp = [](std::span<const Tensor> g, std::span<const InputGradient> in) {
                          in[0].put(nova::mul(g[0], 3.0f));
                        }};
  Tape tape;
  const TapeScope scope(tape);
  tape.record_custom(thrice);
  tape.backward(nova::add(nova::sum(y), nova::dot(x, x)));
  EXPECT_EQ(x.grad().to_host(), (Floats{5.0f, 7.0f}));
}

// The tape guards only the values that the functions read.
struct Declared : ::testing::Test {
  const Tensor x = tensor({1.0f, 2.0f}, true), y = tensor({0.0f, 0.0f}), factor = tensor({3.0f});
  Tape tape;
  CustomOp scale(std::vector<Tensor> reads) {
    return {
        .name = "scale",
        .inputs = {x},
        .outputs = {y},
        .vjp = [f = factor](std::span<const Tensor> g,
                            std::span<const InputGradient> in) { in[0].put(nova::mul(g[0], f)); },
        .reads = std::move(reads)};
  }
};

TEST_F(Declared, AValueThatItDoesNotReadMayBeOverwritten) {
  const TapeScope scope(tape);
  tape.record_custom(scale({factor}));
  const Tensor z = nova::mul(y, 1.0f);
  x.fill_(7.0f);
  y.fill_(7.0f);
  tape.backward(z, tensor({1.0f, 1.0f}));
  EXPECT_EQ(x.grad().to_host(), (Floats{3.0f, 3.0f}));
}

TEST_F(Declared, AValueThatItReadsMayNot) {
  for (const auto& [reads, changed, named] :
       {std::tuple{factor, factor, "value 0 that it reads"}, std::tuple{x, x, "input 0"},
        std::tuple{y, y, "output 0"}}) {
    tape.reset();
    const TapeScope scope(tape);
    tape.record_custom(scale({reads}));
    const Tensor z = nova::mul(y, 1.0f);
    changed.fill_(7.0f);
    EXPECT_ERROR(tape.backward(z, tensor({1.0f, 1.0f})), ErrorKind::Runtime,
                 std::string("input '") + named + "' of op 'scale' was modified after recording");
  }
}

TEST_F(Declared, AReadValueWithAGradientMustBeAnInput) {
  factor.set_requires_grad(true);
  const TapeScope scope(tape);
  EXPECT_ERROR(tape.record_custom(scale({factor})), ErrorKind::Runtime, "make it an input");
  EXPECT_EQ(tape.size(), 0u);
}

TEST_F(Declared, ScratchIsNoMemoryOfAnInput) {
  CustomOp op = scale({});
  op.writes = {x};
  EXPECT_ERROR(tape.record_custom(op), ErrorKind::Value, "memory of an input");
}

TEST_F(Declared, BetweenCheckpointsItNeedsAForwardFunction) {
  const TapeScope scope(tape);
  const nova::RecomputedScope once_more(true);
  EXPECT_ERROR(tape.record_custom(scale({})), ErrorKind::NotImplemented,
               "needs a forward function");
}

// x -> a = 2x (custom, no gradient: of a constant) -> y = a * z, twice in the memory of a.
TEST(CustomOp, WithoutAGradientItIsRunOnceMoreForThoseThatReadIt) {
  const Tensor z = tensor({3.0f}, true), a = tensor({0.0f}), sums = tensor({0.0f});
  std::vector<Tensor> y = {tensor({0.0f}), tensor({0.0f})};
  Tape tape;
  const TapeScope scope(tape);
  for (int k = 0; k < 2; ++k) {
    const nova::RecomputedScope once_more(true);
    const Tensor x = tensor({1.0f + static_cast<float>(k)});
    const CustomOp twice{.name = "twice",
                         .inputs = {x},
                         .outputs = {a},
                         .vjp = [](std::span<const Tensor>, std::span<const InputGradient>) {},
                         .forward = [=] { a.copy_(nova::mul(x, 2.0f)); }};
    step(twice);
    y[static_cast<size_t>(k)].copy_(nova::mul(a, z));
  }
  const Tensor loss = nova::add(y[0], y[1]);
  a.fill_(100.0f);
  tape.backward(loss);
  EXPECT_EQ(z.grad().item(), 6.0f);
}

}  // namespace
}  // namespace novaphy::testing
