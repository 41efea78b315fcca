// Tangents on a tape: the result of a chain of operations, rejected calls, and replay. The tests of
// adjoints compare the rules themselves with the oracle (expect_gradients).
#include "novaphy/nova/gradcheck.h"
#include "novaphy/nova/op_list.h"
#include "support.h"

namespace novaphy::testing {
namespace {

using nova::make_kernel;

const Kernel& square() {
  static const Kernel kernel =
      make_kernel("square", {{"x", DType::F32, 1, Access::Direct}}, {{"y", 1}},
                  [](TraceContext& c) { return std::vector{c.f32(0) * c.f32(0)}; });
  return kernel;
}

TEST(Tangent, OfAChainIsTheProductOfItsDerivatives) {
  const Tensor x = tensor({1.0f, -2.0f, 0.5f}, true);
  Tape tape;
  const TapeScope scope(tape);
  const Tensor y = square()(3, {x})[0];
  const Tensor z = square()(3, {y})[0];  // x^4: tangent 4 x^3 u
  const auto t = tape.jvp({y, z}, {x}, {tensor({1.0f, 1.0f, 2.0f})});
  EXPECT_EQ(t[0].to_host(), (std::vector<float>{2.0f, -4.0f, 2.0f}));
  EXPECT_EQ(t[1].to_host(), (std::vector<float>{4.0f, -32.0f, 1.0f}));
}

TEST(Tangent, LeavesGradientsAndTheTapeAsTheyWere) {
  const Tensor x = tensor({3.0f}, true);
  Tape tape;
  const TapeScope scope(tape);
  const Tensor y = square()(1, {x})[0];
  tape.backward(y);
  const auto first = tape.jvp({y}, {x}, {tensor({1.0f})});
  EXPECT_EQ(x.grad().item(), 6.0f);
  EXPECT_EQ(tape.size(), 1u);
  tape.backward(y);
  EXPECT_EQ(x.grad().item(), 12.0f);
  EXPECT_EQ(tape.jvp({y}, {x}, {tensor({0.5f})})[0].item(), 3.0f);
  EXPECT_EQ(first[0].item(), 6.0f);
}

TEST(Tangent, OfAnOutputThatDoesNotDependOnTheInputIsZero) {
  const Tensor x = tensor({3.0f}, true), other = tensor({5.0f}, true);
  Tape tape;
  const TapeScope scope(tape);
  const Tensor y = square()(1, {x})[0], z = square()(1, {other})[0];
  const auto t = tape.jvp({y, z}, {other}, {tensor({1.0f})});
  EXPECT_EQ(t[0].item(), 0.0f);
  EXPECT_EQ(t[1].item(), 10.0f);
}

TEST(Tangent, FollowsMemoryThatIsWrittenAgain) {
  const Kernel twice =
      make_kernel("twice", {{"x", DType::F32, 1, Access::Direct}}, {{"y", 1}},
                  [](TraceContext& c) { return std::vector{c.f32(0) + c.f32(0)}; });
  const Tensor x = tensor({2.0f}, true);
  const Tensor state = tensor({0.0f}), y = tensor({0.0f}), z = tensor({0.0f}), w = tensor({0.0f});
  Tape tape;
  const TapeScope scope(tape);
  const auto step = [&](const Tensor& in, const Tensor& out) {
    const nova::Operand i = in.operand(), o = out.operand();
    twice.launch(1, i, o);
  };
  step(x, state);
  step(state, y);               // 4 x
  step(tensor({7.0f}), state);  // a constant
  step(y, z);                   // 8 x
  step(state, w);
  const nova::Operand constant = w.operand();
  const auto t = tape.jvp({y, z}, {x}, {tensor({1.0f})});
  EXPECT_EQ(t[0].item(), 4.0f);
  EXPECT_EQ(t[1].item(), 8.0f);
  EXPECT_FALSE(tape.must_record({&constant, 1}));
}

TEST(Tangent, ReadsAtComputedRowsWhichHaveNoAdjoint) {
  const Kernel reversed = make_kernel(
      "reversed", {{"x", DType::F32, 1, Access::Indexed}}, {{"y", 1}},
      [](TraceContext& c) { return std::vector{c.f32(0, Int(2) - c.index(), 0) * Real(3.0f)}; });
  const Tensor x = tensor({1.0f, 2.0f, 3.0f}, true);
  Tape tape;
  const TapeScope scope(tape);
  const Tensor y = reversed(3, {x})[0];
  EXPECT_EQ(tape.jvp({y}, {x}, {tensor({1.0f, 10.0f, 100.0f})})[0].to_host(),
            (std::vector<float>{300.0f, 30.0f, 3.0f}));
}

TEST(Tangent, OfAValueThatWasOverwrittenIsRefused) {
  const Tensor x = tensor({3.0f}, true);
  Tape tape;
  const TapeScope scope(tape);
  const Tensor y = square()(1, {x})[0];
  write(x, {4.0f});
  const std::string message = message_of([&] { tape.jvp({y}, {x}, {tensor({1.0f})}); });
  EXPECT_NE(message.find("input 'x' of op 'square' was modified after recording"),
            std::string::npos)
      << message;
}

TEST(Tangent, NamesTheArgumentThatIsWrong) {
  const Tensor x = tensor({3.0f}, true), u = tensor({1.0f});
  Tape tape;
  const TapeScope scope(tape);
  const Tensor y = square()(1, {x})[0];
  EXPECT_NE(message_of([&] { tape.jvp({y}, {x}, {}); }).find("jvp, tangents: expected 1"),
            std::string::npos);
  EXPECT_NE(message_of([&] { tape.jvp({y}, {y}, {u}); }).find("jvp, input 0: expected a leaf"),
            std::string::npos);
  EXPECT_NE(message_of([&] { tape.jvp({x}, {x}, {u}); }).find("jvp, output 0"), std::string::npos);
  EXPECT_NE(message_of([&] {
              tape.jvp({y}, {x}, {tensor({1.0f, 2.0f})});
            }).find("jvp, tangent 0: expected {1} float32"),
            std::string::npos);
}

TEST(Tangent, IsCapturedAndReplayed) {
  const Tensor x = tensor({3.0f}, true), u = tensor({1.0f});
  Tensor t;
  nova::ScopedCapture capture;
  {
    Tape tape;
    const TapeScope scope(tape);
    t = tape.jvp({square()(1, {x})[0]}, {x}, {u})[0];
  }
  capture.end();
  write(x, {5.0f});
  write(u, {2.0f});
  capture.graph()->launch();
  EXPECT_EQ(t.item(), 20.0f);
}

// y = 3 x, as functions.
std::vector<Tensor> custom_triple(const Tensor& x, bool with_tangent) {
  const auto triple = [](const Tensor& from, const Tensor& to) { to.copy_(nova::mul(from, 3.0f)); };
  const Tensor y(x.shape(), DType::F32);
  {
    const NoGrad no_grad;
    triple(x, y);
  }
  nova::CustomOp op = nova::make_custom_op("triple", {x}, {y}, [](const std::vector<Tensor>& g) {
    return std::vector{nova::mul(g[0], 3.0f)};
  });
  if (with_tangent)
    op.jvp = [triple](std::span<const Tensor> in, std::span<const Tensor> out) {
      triple(in[0], out[0]);
    };
  Tape::active()->record_custom(std::move(op));
  return {y};
}

TEST(Tangent, GoesThroughACustomOperationThatHasOne) {
  const Tensor x = tensor({1.0f, 2.0f}, true);
  Tape tape;
  const TapeScope scope(tape);
  const Tensor y = square()(2, custom_triple(x, true))[0];  // 9 x^2
  EXPECT_EQ(tape.jvp({y}, {x}, {tensor({1.0f, 0.5f})})[0].to_host(),
            (std::vector<float>{18.0f, 18.0f}));
}

TEST(Tangent, IsRefusedByACustomOperationThatHasNone) {
  const Tensor x = tensor({1.0f}, true);
  Tape tape;
  const TapeScope scope(tape);
  const Tensor y = custom_triple(x, false)[0];
  EXPECT_NE(message_of([&] {
              tape.jvp({y}, {x}, {tensor({1.0f})});
            }).find("jvp: op 'triple' was recorded without one"),
            std::string::npos);
  EXPECT_FALSE(tape.has_tangents());
}

TEST(Tangent, IsPartOfAGradientCheck) {
  const auto cube = [](const std::vector<Tensor>& in) {
    return nova::sum(nova::mul(nova::mul(in[0], in[0]), in[0]));
  };
  const auto result = nova::gradcheck(cube, {tensor({1.0f, -0.5f, 2.0f})});
  EXPECT_TRUE(result.ok) << result.worst;
  EXPECT_TRUE(result.has_tangent);
  EXPECT_LT(result.dot_product_error, 1e-5f);
}

}  // namespace
}  // namespace novaphy::testing
