// Clipping of gradients: the bits of the rule written by hand. Invalid calls are rejected by name.
#include <cmath>

#include "novaphy/core/parallel.h"
#include "optim_support.h"

namespace novaphy::testing {
namespace {

// The row-sum rule of <novaphy/abi/program.h>, of squares, starting from init.
float sum_of_squares(const Floats& g, float init) {
  Floats items;
  for (const float x : g) items.push_back(x * x);
  bool whole = items.size() <= NOVAPHY_ROW_SUM_CHUNK;
  float total = whole ? init : 0.0f;
  while (items.size() > NOVAPHY_ROW_SUM_CHUNK) {
    Floats chunks;
    for (size_t k = 0; k < items.size(); k += NOVAPHY_ROW_SUM_CHUNK) {
      float sum = 0.0f;
      for (size_t j = k; j < std::min(items.size(), k + NOVAPHY_ROW_SUM_CHUNK); ++j)
        sum += items[j];
      chunks.push_back(sum);
    }
    items = chunks;
  }
  for (const float x : items) total += x;
  return whole ? total : init + total;
}

TEST(ClipGradNorm, ScalesByPyTorchsFactorOverAllParametersForAnyNumberOfThreads) {
  Random random(41);
  const Floats g1 = random.values(70000), g2 = random.values(6), g3 = random.values(256);
  const float norm = std::sqrt(sum_of_squares(g3, sum_of_squares(g2, sum_of_squares(g1, 0.0f))));
  const float factor = 2.5f / (norm + 1e-6f);
  double exact = 0.0;
  for (const Floats* g : {&g1, &g2, &g3})
    for (const float x : *g) exact += static_cast<double>(x) * static_cast<double>(x);
  EXPECT_NEAR(norm / std::sqrt(exact), 1.0, 1e-6);
  const auto scaled = [&](Floats g) {
    for (float& x : g) x = x * factor;
    return g;
  };
  const int threads_before = num_threads();
  for (const int threads : {1, 2, 7}) {
    set_num_threads(threads);
    const Tensor a = leaf(Floats(70000, 1.0f), g1), b = tensor(Floats(6, 1.0f), {2, 3}, true),
                 c = leaf(Floats(256, 1.0f), g3);
    write(b.grad(), g2);
    const Tensor before = nova::clip_grad_norm_({a, b, c}, 2.5f);
    EXPECT_EQ(before.shape(), Shape{1});
    EXPECT_TRUE(bits(before, {norm}));
    EXPECT_TRUE(bits(a.grad(), scaled(g1)));
    EXPECT_TRUE(bits(b.grad(), scaled(g2)));
    EXPECT_TRUE(bits(c.grad(), scaled(g3)));
    EXPECT_EQ(a.to_host(), Floats(70000, 1.0f));
    EXPECT_NEAR(nova::clip_grad_norm_({a, b, c}, kInf).item(), 2.5f, 1e-5f);
  }
  set_num_threads(threads_before);
}

TEST(ClipGradNorm, KeepsTheBitsOfShortGradients) {
  const Floats g = {3.0f, -4.0f, -0.0f, 1e-40f};
  const Tensor x = leaf(Floats(4, 0.0f), g);
  for (const float limit : {5.1f, 1e30f, kInf}) {
    EXPECT_EQ(nova::clip_grad_norm_({x}, limit).item(), 5.0f);
    EXPECT_TRUE(bits(x.grad(), g));
  }
  x.zero_grad();
  EXPECT_EQ(nova::clip_grad_norm_({x}, 1.0f).item(), 0.0f);
  EXPECT_TRUE(bits(x.grad(), Floats(4, 0.0f)));
}

TEST(ClipGradNorm, ANormThatIsNotFiniteGivesZeroGradients) {
  for (const float bad : {kNaN, kInf, -kInf, 1e30f}) {
    const Tensor x = leaf({1.0f, 2.0f}, {3.0f, bad}), y = leaf({5.0f}, {4.0f});
    const float norm = nova::clip_grad_norm_({x, y}, 1.0f).item();
    EXPECT_EQ(std::isnan(norm), std::isnan(bad));
    EXPECT_FALSE(std::isfinite(norm));
    EXPECT_TRUE(bits(x.grad(), {0.0f, 0.0f}));
    EXPECT_TRUE(bits(y.grad(), {0.0f}));
    SGD({x, y}, {.lr = 1.0f}).step();
    EXPECT_EQ(x.to_host(), (Floats{1.0f, 2.0f}));
  }
}

TEST(ClipGradValue, LimitsEveryValue) {
  const Tensor x = leaf(Floats(6, 0.0f), {-3.0f, -0.5f, -0.0f, 2.0f, kInf, kNaN}),
               y = leaf({0.0f}, {-9.0f});
  nova::clip_grad_value_({x, y}, 1.5f);
  const Floats g = grad(x);
  EXPECT_EQ(Floats(g.begin(), g.begin() + 5), (Floats{-1.5f, -0.5f, -0.0f, 1.5f, 1.5f}));
  EXPECT_TRUE(std::isnan(g[5]));
  EXPECT_EQ(grad(y), Floats{-1.5f});
}

TEST(Clamp, LimitsTheParameterAndLeavesItsGradient) {
  const Tensor x = leaf({-3.0f, 0.25f, 7.0f}, {1.0f, 2.0f, 3.0f});
  nova::clamp_(x, -1.0f, 0.5f);
  EXPECT_EQ(x.to_host(), (Floats{-1.0f, 0.25f, 0.5f}));
  EXPECT_EQ(grad(x), (Floats{1.0f, 2.0f, 3.0f}));
  nova::clamp_(x, -kInf, 0.0f);
  EXPECT_EQ(x.to_host(), (Floats{-1.0f, 0.0f, 0.0f}));
}

TEST(Clipping, RefusesBadArgumentsByNameAndWritesNothing) {
  const Tensor x = leaf({1.0f}, {9.0f}), y = tensor({1.0f}, true);
  const auto value = ErrorKind::Value, type = ErrorKind::Type;
  for (const float limit : {0.0f, -1.0f, kNaN}) {
    EXPECT_ERROR(nova::clip_grad_norm_({x}, limit), value,
                 "clip_grad_norm_, max_norm: expected a number > 0, got");
    EXPECT_ERROR(nova::clip_grad_value_({x}, limit), value,
                 "clip_grad_value_, v: expected a number > 0, got");
  }
  EXPECT_ERROR(nova::clip_grad_norm_({}, 1.0f), value,
               "clip_grad_norm_, params: expected at least one tensor");
  EXPECT_ERROR(nova::clip_grad_norm_({x, y}, 1.0f), value,
               "clip_grad_norm_, params[1]: it has no gradient");
  EXPECT_ERROR(nova::clip_grad_norm_({x, x}, 1.0f), value, "params[1]: expected memory of its own");
  EXPECT_ERROR(nova::clip_grad_value_({x, y}, 1.0f), value,
               "clip_grad_value_, params[1]: it has no gradient");
  EXPECT_ERROR(nova::clip_grad_value_({table({1})}, 1.0f), type,
               "clip_grad_value_, params[0]: expected float32, got int32");
  EXPECT_ERROR(nova::clamp_(table({1}), 0.0f, 1.0f), type,
               "clamp_, param: expected float32, got int32");
  EXPECT_ERROR(nova::clamp_(x, 1.0f, 0.0f), value, "clamp_: expected lower <= upper, got 1 and 0");
  EXPECT_ERROR(nova::clamp_(x, kNaN, 0.0f), value, "clamp_: expected lower <= upper");
  EXPECT_EQ(grad(x), Floats{9.0f});
  EXPECT_EQ(x.item(), 1.0f);
}

}  // namespace
}  // namespace novaphy::testing
