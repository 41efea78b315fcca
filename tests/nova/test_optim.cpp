// Optimizers: compared with recurrences written by hand, also in captures with clipping. Invalid
// calls are rejected by name.
#include <cmath>

#include "novaphy/nova/op_list.h"
#include "optim_support.h"
#include "support/allocations.h"

namespace novaphy::testing {
namespace {

using nova::ScopedCapture;

// ---- Adam ----

struct AdamByHand {
  float lr = 1e-3f, beta1 = 0.9f, beta2 = 0.999f, eps = 1e-8f;
  // 1 - beta^t: squares of the power for the bits of t, the complement carried along.
  static float correction(uint32_t t, float beta) {
    float total = 0.0f;
    for (float power = 1.0f - beta; t != 0; t >>= 1, power = power * (2.0f - power))
      if (t & 1) total = total + power * (1.0f - total);
    return total;
  }
  void step(uint32_t t, const Floats& g, Floats& p, Floats& m, Floats& v) const {
    const float c1 = correction(t, beta1), c2 = correction(t, beta2);
    for (size_t k = 0; k < p.size(); ++k) {
      m[k] = beta1 * m[k] + (1.0f - beta1) * g[k];
      v[k] = beta2 * v[k] + (1.0f - beta2) * g[k] * g[k];
      p[k] = p[k] - lr * (m[k] / c1) / (std::sqrt(v[k] / c2) + eps);
    }
  }
};

TEST(AdamUpdate, HasTheBitsOfTheRecurrenceWrittenOut) {
  const AdamByHand options[] = {{}, {0.1f, 0.5f, 0.75f, 1e-3f}, {1.0f, 0.0f, 0.0f, 1e-8f}};
  for (const AdamByHand& hand : options) {
    SCOPED_TRACE(hand.beta2);
    Random random(3);
    Floats p = random.values(600), m(600, 0.0f), v(600, 0.0f);
    const Tensor x = tensor(p, {200, 3}, true), tm(Shape{200, 3}), tv(Shape{200, 3}), t(Shape{1});
    for (uint32_t step = 1; step <= 50; ++step) {
      const Floats g = random.values(600);
      write(x.grad(), g);
      nova::adam_update_f32(x, tm, tv, t, hand.lr, hand.beta1, hand.beta2, hand.eps);
      hand.step(step, g, p, m, v);
    }
    EXPECT_TRUE(bits(x, p));
    EXPECT_TRUE(bits(tm, m));
    EXPECT_TRUE(bits(tv, v));
    EXPECT_EQ(t.item(), 50.0f);
  }
}

TEST(AdamUpdate, FollowsAlgorithm1InDoublePrecision) {
  Random random(5);
  const Floats start = random.values(20);
  const Tensor x = tensor(start, true), tm(Shape{20}), tv(Shape{20}), t(Shape{1});
  std::vector<double> p(start.begin(), start.end()), m(20, 0.0), v(20, 0.0);
  const double beta1 = 0.9f, beta2 = 0.999f;
  for (int step = 1; step <= 1000; ++step) {
    const Floats g = random.values(20);
    write(x.grad(), g);
    nova::adam_update_f32(x, tm, tv, t, 1e-2f);
    for (size_t k = 0; k < 20; ++k) {
      const auto gk = static_cast<double>(g[k]);
      m[k] = beta1 * m[k] + (1.0 - beta1) * gk;
      v[k] = beta2 * v[k] + (1.0 - beta2) * gk * gk;
      const double m_hat = m[k] / (1.0 - std::pow(beta1, step));
      const double v_hat = v[k] / (1.0 - std::pow(beta2, step));
      p[k] -= static_cast<double>(1e-2f) * m_hat / (std::sqrt(v_hat) + 1e-8);
    }
  }
  const Floats actual = x.to_host();
  for (size_t k = 0; k < 20; ++k) EXPECT_NEAR(actual[k], p[k], 1e-4);
}

// With beta2 = 0, zero moments and gradient 1, a step of rate 1 from 0 is -(1 - beta1) / (1 -
// beta1^t).
TEST(AdamUpdate, CorrectsTheBiasToTwoMillionthsAtEveryStep) {
  for (const float beta : {0.0f, 0.1f, 0.5f, 0.9f, 0.99f, 0.999f, 0.99999f, 0x1.fffffep-1f}) {
    for (const float before : {0.0f, 1.0f, 2.0f, 6.0f, 99.0f, 12344.0f, 1e6f, 16777214.0f}) {
      const Tensor x = leaf({0.0f}, {1.0f}), m(Shape{1}), v(Shape{1}), t = tensor({before});
      nova::adam_update_f32(x, m, v, t, 1.0f, beta, 0.0f, 1e-30f);
      const double b = static_cast<double>(beta), n = static_cast<double>(before) + 1.0;
      const double exact = beta == 0.0f ? 1.0 : -std::expm1(n * std::log(b));
      const double actual = -(1.0 - b) / static_cast<double>(x.item());
      EXPECT_NEAR(actual / exact, 1.0, 2e-6) << beta << " at " << n;
      EXPECT_EQ(t.item(), before + 1.0f);
    }
  }
}

TEST(AdamUpdate, MovesByTheRateInTheFirstStepWhateverTheGradientsLength) {
  const Tensor x = leaf({0.0f, 0.0f, 0.0f, 0.0f}, {1e-3f, -1.0f, 1e6f, 0.0f});
  const Tensor m(Shape{4}), v(Shape{4}), t(Shape{1});
  nova::adam_update_f32(x, m, v, t, 0.5f);
  const Floats p = x.to_host();
  EXPECT_NEAR(p[0], -0.5f, 1e-5f);
  EXPECT_NEAR(p[1], 0.5f, 1e-6f);
  EXPECT_NEAR(p[2], -0.5f, 1e-6f);
  EXPECT_EQ(p[3], 0.0f);
}

TEST(AdamUpdate, CountsFromWhateverTIsAndStopsWhereFloatsDo) {
  const Tensor x = leaf({0.0f}, {1.0f}), m(Shape{1}), v(Shape{1}), t(Shape{1});
  const std::pair<float, float> counts[] = {{0.0f, 1.0f},        {41.0f, 42.0f},
                                            {-7.0f, 1.0f},       {kNaN, 1.0f},
                                            {kInf, 16777215.0f}, {16777215.0f, 16777215.0f}};
  for (const auto& [before, after] : counts) {
    write(t, {before});
    nova::adam_update_f32(x, m, v, t, 0.1f);
    EXPECT_EQ(t.item(), after) << before;
    EXPECT_TRUE(std::isfinite(x.item()));
  }
}

TEST(AdamUpdate, RefusesBadArgumentsByNameAndWritesNothing) {
  const Tensor x = leaf({1.0f, 2.0f}, {1.0f, 1.0f}), m(Shape{2}), v(Shape{2}), t(Shape{1});
  const auto update = [&](const Tensor& p, const Tensor& pm, const Tensor& pv, const Tensor& pt) {
    nova::adam_update_f32(p, pm, pv, pt, 0.1f);
  };
  const auto value = ErrorKind::Value, type = ErrorKind::Type;
  EXPECT_ERROR(update(table({1}), m, v, t), type,
               "adam_update_f32, param: expected float32, got int32");
  EXPECT_ERROR(update(x, table({1, 2}), v, t), type, "m: expected float32, got int32");
  EXPECT_ERROR(update(x, m, Tensor(), t), type, "v: expected float32, got an undefined tensor");
  EXPECT_ERROR(update(x, m, v, table({0})), type, "t: expected float32, got int32");
  EXPECT_ERROR(update(tensor({1.0f, 2.0f}), m, v, t), value, "param: it has no gradient");
  EXPECT_ERROR(update(x, Tensor(Shape{3}), v, t), value, "m: expected shape {2}, got {3}");
  EXPECT_ERROR(update(x, m, Tensor(Shape{2, 1}), t), value, "v: expected shape {2}, got {2, 1}");
  EXPECT_ERROR(update(x, m, v, Tensor(Shape{2})), value, "t: expected shape {1}, got {2}");
  EXPECT_ERROR(update(x, m, m, t), value, "v: expected memory of its own, got that of m");
  EXPECT_ERROR(update(x, x, v, t), value, "m: expected memory of its own, got that of param");
  EXPECT_ERROR(update(x, m, x.grad(), t), value,
               "v: expected memory of its own, got that of param.grad");
  const auto rates = [&](float lr, float beta1, float beta2, float eps) {
    nova::adam_update_f32(x, m, v, t, lr, beta1, beta2, eps);
  };
  for (const float lr : {-1.0f, kNaN, kInf})
    EXPECT_ERROR(rates(lr, 0.9f, 0.999f, 1e-8f), value, "lr: expected a finite number >= 0, got");
  for (const float beta : {-0.1f, 1.0f, 2.0f, kNaN}) {
    EXPECT_ERROR(rates(0.1f, beta, 0.999f, 1e-8f), value,
                 "beta1: expected a float32 in [0, 1), got");
    EXPECT_ERROR(rates(0.1f, 0.9f, beta, 1e-8f), value, "beta2: expected a float32 in [0, 1), got");
  }
  for (const float eps : {0.0f, -1.0f, kNaN, kInf})
    EXPECT_ERROR(rates(0.1f, 0.9f, 0.999f, eps), value, "eps: expected a finite float32 > 0, got");
  EXPECT_TRUE(bits(x, {1.0f, 2.0f}));
  EXPECT_TRUE(bits(m, {0.0f, 0.0f}));
  EXPECT_TRUE(bits(v, {0.0f, 0.0f}));
  EXPECT_EQ(t.item(), 0.0f);
  EXPECT_EQ(t.version(), 0u);
}

TEST(AdamClass, IsTheUpdateOfEveryParameterWithOneStepCounter) {
  Random random(11);
  const Tensor a = random.leaf({7, 3}), b = random.leaf({5});
  const Tensor a2 = tensor(a.to_host(), {7, 3}, true), b2 = tensor(b.to_host(), true);
  Adam adam({a, b}, {.lr = 0.05f, .beta1 = 0.8f, .beta2 = 0.95f, .eps = 1e-6f});
  const Tensor am(Shape{7, 3}), av(Shape{7, 3}), at(Shape{1}), bm(Shape{5}), bv(Shape{5}),
      bt(Shape{1});
  for (int k = 0; k < 12; ++k) {
    const Floats ga = random.values(21), gb = random.values(5);
    for (const Tensor& p : {a, a2}) write(p.grad(), ga);
    for (const Tensor& p : {b, b2}) write(p.grad(), gb);
    const float lr = k < 6 ? 0.05f : 0.01f;
    adam.set_lr(lr);
    adam.step();
    nova::adam_update_f32(a2, am, av, at, lr, 0.8f, 0.95f, 1e-6f);
    nova::adam_update_f32(b2, bm, bv, bt, lr, 0.8f, 0.95f, 1e-6f);
  }
  EXPECT_TRUE(bits(a, a2.to_host()));
  EXPECT_TRUE(bits(b, b2.to_host()));
  EXPECT_TRUE(bits(adam.m()[0], am.to_host()));
  EXPECT_TRUE(bits(adam.v()[1], bv.to_host()));
  EXPECT_EQ(adam.t().item(), 12.0f);
  EXPECT_EQ(adam.lr(), 0.01f);
  EXPECT_EQ(adam.params().size(), 2u);
}

TEST(AdamClass, FindsTheMinimumOfAnIllConditionedQuadratic) {
  // f = sum of k (x - c)^2 / 2 with k over four decades
  const Floats stiffness = {0.1f, 1.0f, 10.0f, 1000.0f}, center = {1.0f, -2.0f, 3.0f, -4.0f};
  const Tensor k = tensor(stiffness), c = tensor(center), x = tensor(Floats(4, 0.0f), true);
  Adam adam({x}, {.lr = 0.1f});
  for (int step = 0; step < 2000; ++step) {
    adam.zero_grad();
    Tape tape;
    const TapeScope scope(tape);
    const Tensor d = nova::sub(x, c);
    tape.backward(nova::sum(nova::mul(nova::mul(d, d), nova::mul(k, 0.5f))));
    adam.step();
    EXPECT_EQ(tape.size(), 4u);  // the operations of the loss alone
  }
  const Floats found = x.to_host();
  for (size_t j = 0; j < 4; ++j) EXPECT_NEAR(found[j], center[j], 1e-3);
}

// ---- SGD ----

struct SGDByHand {
  nova::SGDOptions o;
  void step(bool first, const Floats& gradient, Floats& p, Floats& b) const {
    for (size_t k = 0; k < p.size(); ++k) {
      float g = gradient[k];
      if (o.weight_decay != 0.0f) g = g + o.weight_decay * p[k];
      if (o.momentum != 0.0f) {
        b[k] = first ? g : o.momentum * b[k] + (1.0f - o.dampening) * g;
        g = o.nesterov ? g + o.momentum * b[k] : b[k];
      }
      p[k] = p[k] - o.lr * g;
    }
  }
};

TEST(SGDClass, HasTheBitsOfTheRecurrenceWrittenOut) {
  const nova::SGDOptions all[] = {
      {},
      {.lr = 0.1f, .weight_decay = 0.01f},
      {.lr = 0.1f, .momentum = 0.9f},
      {.lr = 0.1f, .momentum = 0.9f, .dampening = 0.5f},
      {.lr = 0.1f, .momentum = 0.9f, .weight_decay = 0.02f, .nesterov = true}};
  for (size_t o = 0; o < std::size(all); ++o) {
    SCOPED_TRACE(o);
    Random random(23);
    Floats p = random.values(60), b(60, 0.0f);
    const Tensor x = tensor(p, {20, 3}, true);
    const SGD sgd({x}, all[o]);
    const SGDByHand hand{all[o]};
    for (int step = 0; step < 20; ++step) {
      const Floats g = random.values(60);
      write(x.grad(), g);
      sgd.step();
      hand.step(step == 0, g, p, b);
    }
    EXPECT_TRUE(bits(x, p));
    EXPECT_EQ(sgd.b().size(), all[o].momentum == 0.0f ? 0u : 1u);
    if (all[o].momentum != 0.0f) {
      EXPECT_TRUE(bits(sgd.b()[0], b));
      EXPECT_EQ(sgd.t().item(), 20.0f);
    }
  }
}

TEST(SGDClass, WithoutMomentumIsSgdUpdateToTheBit) {
  Random random(29);
  const Floats start = random.values(100), g = random.values(100);
  const Tensor x = leaf(start, g), y = leaf(start, g);
  SGD({x}, {.lr = 0.3f}).step();
  nova::sgd_update_f32(y, 0.3f);
  EXPECT_TRUE(bits(x, y.to_host()));
}

TEST(SGDClass, HalvesAParabolaExactly) {
  const Tensor x = tensor({1.0f, -8.0f}, true);  // f = x^2 / 2, so x -> (1 - lr) x
  const SGD sgd({x}, {.lr = 0.5f});
  for (int step = 0; step < 20; ++step) {
    sgd.zero_grad();
    Tape tape;
    const TapeScope scope(tape);
    tape.backward(nova::mul(nova::dot(x, x), 0.5f));
    sgd.step();
  }
  EXPECT_TRUE(bits(x, {0x1p-20f, -0x1p-17f}));
}

TEST(SGDClass, AGradientOfZeroAfterZeroGradLeavesTheParameterToItsMomentum) {
  const Tensor x = leaf({0.0f}, {1.0f});
  const SGD sgd({x}, {.lr = 1.0f, .momentum = 0.5f});
  sgd.step();
  sgd.zero_grad();
  sgd.step();
  EXPECT_EQ(x.item(), -1.5f);
}

TEST(Optimizers, RefuseBadArgumentsByName) {
  const Tensor x = tensor({1.0f}, true), y = tensor({1.0f, 2.0f}, true);
  const auto value = ErrorKind::Value, type = ErrorKind::Type;
  EXPECT_ERROR(Adam({}), value, "Adam, params: expected at least one tensor, got 0");
  EXPECT_ERROR(SGD({}), value, "SGD, params: expected at least one tensor, got 0");
  EXPECT_ERROR(Adam({x, table({1})}), type, "Adam, params[1]: expected float32, got int32");
  EXPECT_ERROR(SGD({Tensor()}), type, "SGD, params[0]: expected float32, got an undefined tensor");
  EXPECT_ERROR(Adam({x, y, x}), value,
               "Adam, params[2]: expected memory of its own, got that of params[0]");
  EXPECT_ERROR(SGD({y, Tensor(y.range()->storage().range(4, 4), {1}, DType::F32)}), value,
               "params[1]");
  for (const float lr : {-1.0f, kNaN, kInf}) {
    EXPECT_ERROR(Adam({x}, {.lr = lr}), value, "Adam, lr: expected a finite number >= 0, got");
    EXPECT_ERROR(SGD({x}, {.lr = lr}), value, "SGD, lr: expected a finite number >= 0, got");
  }
  EXPECT_ERROR(Adam({x}, {.beta1 = 1.0f}), value,
               "Adam, beta1: expected a float32 in [0, 1), got 1");
  EXPECT_ERROR(Adam({x}, {.beta2 = -1.0f}), value, "Adam, beta2");
  EXPECT_ERROR(Adam({x}, {.eps = 0.0f}), value, "Adam, eps: expected a finite float32 > 0, got 0");
  EXPECT_ERROR(SGD({x}, {.momentum = -0.5f}), value, "SGD, momentum");
  EXPECT_ERROR(SGD({x}, {.weight_decay = kNaN}), value, "SGD, weight_decay");
  EXPECT_ERROR(SGD({x}, {.momentum = 0.9f, .dampening = kInf}), value, "SGD, dampening");
  EXPECT_ERROR(SGD({x}, {.nesterov = true}), value, "SGD, nesterov: expected a momentum > 0");
  EXPECT_ERROR(SGD({x}, {.momentum = 0.9f, .dampening = 0.1f, .nesterov = true}), value,
               "SGD, nesterov");
  Adam adam({x});
  EXPECT_ERROR(adam.set_lr(kNaN), value, "Adam, lr");
  EXPECT_EQ(adam.lr(), 1e-3f);
}

TEST(Optimizers, AStepWithAMissingGradientChangesNothing) {
  const Tensor x = leaf({1.0f}, {1.0f}), y = tensor({2.0f}, true);
  const Adam adam({x, y});
  const SGD sgd({x, y}, {.momentum = 0.5f});
  EXPECT_ERROR(adam.step(), ErrorKind::Value, "Adam, params[1]: it has no gradient");
  EXPECT_ERROR(sgd.step(), ErrorKind::Value, "SGD, params[1]: it has no gradient");
  EXPECT_EQ(adam.t().item(), 0.0f);
  EXPECT_EQ(sgd.t().item(), 0.0f);
  EXPECT_EQ(x.item(), 1.0f);
  y.grad();
  adam.step();
  EXPECT_EQ(adam.t().item(), 1.0f);
  EXPECT_EQ(y.item(), 2.0f);
}

TEST(Optimizers, NothingIsAllocatedByALaterStep) {
  Random random(31);
  std::vector<Tensor> params = {random.leaf({300, 3}), random.leaf({4})};
  for (const Tensor& p : params) write(p.grad(), random.values(p.size()));
  const Adam adam(params);
  const SGD sgd(params, {.momentum = 0.9f, .weight_decay = 0.1f}), plain(params);
  const auto steps = [&] {
    adam.step();
    sgd.step();
    plain.step();
  };
  EXPECT_EQ(allocations_of(steps, 10), 0);
}

TEST(Optimizers, AnEmptyParameterIsNoError) {
  const Tensor empty = tensor({}, true), x = leaf({1.0f}, {3.0f});
  empty.grad();
  EXPECT_EQ(nova::clip_grad_norm_({empty, x}, 1.5f).item(), 3.0f);
  EXPECT_EQ(nova::clip_grad_norm_({empty}, 1.5f).item(), 0.0f);
  nova::clip_grad_value_({empty, x}, 1.0f);
  nova::clamp_(empty, 0.0f, 1.0f);
  SGD({empty, x}, {.lr = 1.0f, .momentum = 0.5f}).step();
  Adam({empty, x}).step();
  EXPECT_LT(x.item(), 0.5f);
}

// ---- captures and tapes ----

// A complete training: two parameters, a loss that couples them, clipping, two optimizers.
class Training {
 public:
  explicit Training(int64_t n) : Training(n, Random(51)) {}
  Tensor iterate() const {
    Tape tape;
    const TapeScope scope(tape);
    const Tensor d = nova::sub(nova::mul(nova::sin(x), scale), 0.5f);
    const Tensor loss = nova::dot(d, d);
    tape.backward(loss);
    const Tensor norm = nova::clip_grad_norm_({x, scale}, 3.0f);
    nova::clip_grad_value_({x}, 0.5f);
    adam.step();
    sgd.step();
    nova::adam_update_f32(scale, m, v, t, 1e-2f);
    nova::clamp_(x, -1.5f, 1.5f);
    tape.zero();
    EXPECT_EQ(tape.op_names().back(), "sum");  // nothing after the loss
    const NoGrad no_grad;
    return nova::add(loss, norm);
  }
  std::vector<Floats> state() const {
    return {x.to_host(),        scale.to_host(),      adam.m()[0].to_host(), adam.v()[0].to_host(),
            adam.t().to_host(), sgd.b()[0].to_host(), sgd.t().to_host(),     m.to_host(),
            v.to_host(),        t.to_host()};
  }
  Tensor x, scale, m{Shape{1}}, v{Shape{1}}, t{Shape{1}};
  Adam adam;
  SGD sgd;

 private:
  Training(int64_t n, Random random)
      : x(random.leaf({n})),
        scale(tensor({0.7f}, true)),
        adam({x}, {.lr = 0.02f}),
        sgd({scale}, {.lr = 1e-3f, .momentum = 0.8f, .dampening = 0.3f, .weight_decay = 0.1f}) {}
};

TEST(OptimizerCapture, AReplayIsAStepWithTheBitsOfTheEagerLoop) {
  for (const int64_t n : {int64_t{1}, int64_t{5}, int64_t{300}, int64_t{2048}, int64_t{5000}}) {
    SCOPED_TRACE(n);
    const Training eager(n), replayed(n);
    ScopedCapture capture;
    const Tensor seen = replayed.iterate();
    capture.end();
    EXPECT_EQ(replayed.t.item(), 0.0f);
    for (int k = 0; k < 20; ++k) {
      const Floats expected = eager.iterate().to_host();
      capture.graph()->launch();
      ASSERT_TRUE(bits(seen, expected)) << k;
      const auto a = eager.state(), b = replayed.state();
      for (size_t s = 0; s < a.size(); ++s)
        ASSERT_TRUE(same_bits(std::span<const float>(b[s]), std::span<const float>(a[s])))
            << k << ", " << s;
    }
    for (const Tensor& t : {replayed.t, replayed.adam.t(), replayed.sgd.t()})
      EXPECT_EQ(t.item(), 20.0f);
  }
}

TEST(OptimizerCapture, ALaunchAllocatesNothing) {
  const Training training(300);
  ScopedCapture capture;
  training.iterate();
  capture.end();
  capture.graph()->launch();
  nova::wait_for_compilers();  // threads of devices, which allocate
  capture.graph()->launch();
  EXPECT_EQ(allocations_of([&] { capture.graph()->launch(); }, 5), 0);
}

TEST(OptimizerCapture, KeepsTheRateOfItsMoment) {
  const Tensor x = leaf({0.0f}, {1.0f});
  SGD sgd({x}, {.lr = 1.0f});
  ScopedCapture capture;
  sgd.step();
  capture.end();
  sgd.set_lr(0.25f);
  capture.graph()->launch();
  EXPECT_EQ(x.item(), -1.0f);
  sgd.step();
  EXPECT_EQ(x.item(), -1.25f);
}

TEST(OptimizerCapture, AGraphOutlivesTheOptimizerAndItsState) {
  const Tensor x = leaf({0.0f}, {1.0f});
  std::shared_ptr<nova::OpList> graph;
  {
    const Adam adam({x}, {.lr = 0.5f});
    ScopedCapture capture;
    nova::clip_grad_norm_({x}, 10.0f);
    adam.step();
    graph = capture.graph();
  }
  const Tensor churn = Tensor::full({64}, 1e9f);
  for (int k = 1; k <= 3; ++k) {
    graph->launch();
    EXPECT_NEAR(x.item(), -0.5f * static_cast<float>(k), 1e-5f);
  }
}

TEST(OptimizerTape, AStepOverwritesWhatATapeRecorded) {
  const Tensor x = tensor({1.0f, 2.0f}, true);
  const Adam adam({x});
  Tape tape;
  const TapeScope scope(tape);
  const Tensor loss = nova::dot(x, x);
  tape.backward(loss);
  adam.step();
  EXPECT_ERROR(tape.backward(loss), ErrorKind::Runtime, "was modified after recording");
}

}  // namespace
}  // namespace novaphy::testing
