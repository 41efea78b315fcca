// Handwritten kernels of libraries without the tensor runtime, recorded by the runtime.
#include <numeric>

#include "novaphy/core/device_kernel.h"
#include "novaphy/core/launch_list.h"
#include "novaphy/core/parallel.h"
#include "novaphy/nova/op_list.h"
#include "support.h"
#include "support/scale_kernels.h"

namespace novaphy::testing {
namespace {

using nova::ScopedCapture;

const novaphy::Kernel<ScaleArguments> kScale(test_scale, nullptr);
const novaphy::Kernel<ScaleConstantArguments> kScaleConstant(test_scale_constant, nullptr);
const novaphy::Kernel<ReverseArguments> kReverse(test_reverse, nullptr);

DeviceArray<float> array_of(const Tensor& t) {
  return DeviceArray<float>(
      Array(novaphy::DType::float32, static_cast<size_t>(t.size()), 1, t.range()));
}
void scale(const Tensor& x, const Tensor& y, float factor, bool detached = false) {
  const DeviceArray<float> from = array_of(x), to = array_of(y);
  if (detached) {
    run(kScaleConstant, x.size(), {.x = from, .y = to, .factor = factor});
  } else {
    run(kScale, x.size(), {.x = from, .y = to, .factor = factor});
  }
}
void reverse(const Tensor& x, const Tensor& y) {
  const DeviceArray<float> from = array_of(x), to = array_of(y);
  run(kReverse, x.size(), {.x = from, .y = to});
}

class HandWritten : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!default_device().is_cpu()) GTEST_SKIP() << "these kernels are for the CPU";
  }
};

// Between row-local kernels that may be run block by block, kernels that read other rows.
TEST_F(HandWritten, ACaptureReplaysThemInOrder) {
  const int before = num_threads();
  for (const int64_t n : {5, 300, 5000}) {
    Random random(3);
    const Tensor x = tensor(random.values(n)), a({n}, DType::F32), b({n}, DType::F32),
                 c({n}, DType::F32);
    const auto work = [&] {
      Tensor y = nova::mul(x, x);
      for (int k = 0; k < 3; ++k) {
        scale(y, a, 0.5f);
        reverse(a, b);
        y = nova::add(b, a);
        reverse(y, c);
        y = nova::mul(nova::add(c, y), x);
      }
      return y;
    };
    std::vector<std::vector<float>> expected;
    const std::vector<float> first = x.to_host(), second = random.values(n);
    for (const auto& values : {first, second}) {
      write(x, values);
      expected.push_back(work().to_host());
    }
    std::optional<ScopedCapture> scope(std::in_place);
    const Tensor out = work();
    scope->end();
    const uint64_t version = c.version();
    for (const int threads : {1, 2, 7}) {
      set_num_threads(threads);
      for (const auto& values : {first, second}) {
        write(x, values);
        scope->graph()->launch();
        EXPECT_TRUE(same_bits<float>(out.to_host(), expected[values == second]))
            << n << " rows, " << threads << " threads";
      }
    }
    EXPECT_GT(c.version(), version) << "a replay writes";
    set_num_threads(before);
  }
}

TEST_F(HandWritten, ACaptureRunsNothingAndKeepsTheMemoryAlive) {
  std::weak_ptr<nova::Range> kept;
  const Tensor x = tensor({1.0f, 2.0f}), out({2}, DType::F32);
  std::optional<ScopedCapture> scope(std::in_place);
  {
    const Tensor between({2}, DType::F32);
    kept = between.range();
    scale(x, between, 3.0f);
    reverse(between, out);
  }
  scope->end();
  EXPECT_FALSE(kept.expired());
  EXPECT_EQ(out.to_host(), (std::vector<float>{0.0f, 0.0f}));
  scope->graph()->launch();
  EXPECT_EQ(out.to_host(), (std::vector<float>{6.0f, 3.0f}));
}

TEST_F(HandWritten, ACaptureRecordsALaunchList) {
  const Tensor x = tensor({1.0f, 2.0f}), between({2}, DType::F32), out({2}, DType::F32);
  const DeviceArray<float> from = array_of(x), middle = array_of(between), to = array_of(out);
  LaunchList list(Device::cpu());
  const auto first = list.add(kScale, 2, {.x = from, .y = middle, .factor = 3.0f});
  list.add(kReverse, 2, {.x = middle, .y = to});
  std::optional<ScopedCapture> scope(std::in_place);
  list.run();
  scope->end();
  EXPECT_EQ(out.to_host(), (std::vector<float>{0.0f, 0.0f})) << "it runs nothing";
  list.set(first, {.x = from, .y = middle, .factor = 5.0f});
  write(x, {2.0f, 4.0f});
  scope->graph()->launch();
  EXPECT_EQ(out.to_host(), (std::vector<float>{12.0f, 6.0f})) << "as it was recorded";

  const Tensor w = tensor({1.0f, 2.0f}, true);
  const DeviceArray<float> carries = array_of(w);
  list.set(first, {.x = carries, .y = middle, .factor = 5.0f});
  Tape tape;
  const TapeScope tape_scope(tape);
  EXPECT_ERROR(list.run(), ErrorKind::Runtime,
               "test_scale, x: it carries a gradient of the active Tape");
}

TEST_F(HandWritten, ADeferredListRunsThemAtItsPlace) {
  const int64_t n = 4096;
  Random random(5);
  const Tensor x = tensor(random.values(n)), a({n}, DType::F32), b({n}, DType::F32);
  const auto work = [&] {
    const Tensor y = nova::mul(x, x);
    reverse(y, a);
    scale(nova::add(a, x), b, 2.0f);
    return nova::add(b, y);
  };
  const std::vector<float> expected = work().to_host();
  nova::DeferredScope deferred(true);
  const Tensor out = work();
  deferred.flush();
  EXPECT_TRUE(same_bits<float>(out.to_host(), expected));
}

TEST_F(HandWritten, UnderATapeReadingAGradientRaises) {
  const Tensor x = tensor({1.0f, 2.0f}, true), y({2}, DType::F32);
  Tape tape;
  const TapeScope scope(tape);
  EXPECT_ERROR(scale(x, y, 2.0f), ErrorKind::Runtime,
               "test_scale, x: it carries a gradient of the active Tape");
  EXPECT_EQ(y.to_host(), (std::vector<float>{0.0f, 0.0f})) << "nothing was written";
  const Tensor computed = nova::mul(x, x);
  EXPECT_ERROR(scale(computed, y, 2.0f), ErrorKind::Runtime, "test_scale, x: it carries");
  const Tensor constant = tensor({4.0f, 5.0f});
  scale(constant, y, 2.0f);
  EXPECT_EQ(y.to_host(), (std::vector<float>{8.0f, 10.0f}));
}

TEST_F(HandWritten, WhatIsDeclaredDetachedIsAConstant) {
  const Tensor x = tensor({1.0f, 2.0f}, true), y({2}, DType::F32);
  Tape tape;
  const TapeScope scope(tape);
  scale(x, y, 2.0f, true);
  const Tensor loss = nova::sum(nova::mul(y, x));
  tape.backward(loss);
  EXPECT_EQ(x.grad().to_host(), (std::vector<float>{2.0f, 4.0f}));
}

// The tape does not confuse a gradient that it wrote earlier with the gradient of the present
// values.
TEST_F(HandWritten, WhatTheyOverwriteIsAConstant) {
  const Tensor x = tensor({3.0f, 4.0f}, true), constant = tensor({1.0f, 2.0f});
  Tape tape;
  const TapeScope scope(tape);
  const Tensor y = nova::mul(x, x);
  scale(constant, y, 10.0f);
  const Tensor loss = nova::sum(nova::mul(y, x));
  tape.backward(loss);
  EXPECT_EQ(x.grad().to_host(), (std::vector<float>{10.0f, 20.0f}));
}

TEST_F(HandWritten, ACustomOperationGivesTheirDerivative) {
  const Tensor x = tensor({1.0f, 2.0f}, true), y({2}, DType::F32);
  Tape tape;
  const TapeScope scope(tape);
  {
    const NoGrad no_grad;
    scale(x, y, 3.0f);
  }
  tape.record_custom("scale", {x}, {y}, [](const std::vector<Tensor>& grads) {
    const Tensor gx(grads[0].shape(), DType::F32);
    scale(grads[0], gx, 3.0f);
    return std::vector<Tensor>{gx};
  });
  const Tensor loss = nova::sum(nova::mul(y, y));
  tape.backward(loss);
  EXPECT_EQ(x.grad().to_host(), (std::vector<float>{18.0f, 36.0f}));
}

// All steps share the memory of the kernel's results, which the gradient needs.
TEST_F(HandWritten, BetweenCheckpointsTheyRunOnceMore) {
  const Tensor x = tensor({1.0f, 2.0f, 3.0f}, true), left({3}, DType::F32);
  const auto iterate = [&](bool checkpoints) {
    x.zero_grad();
    Tape tape;
    const TapeScope scope(tape);
    Tensor y = x;
    for (int k = 0; k < 3; ++k) {
      const nova::RecomputedScope group(checkpoints);
      reverse(y.detach(), left);
      y = nova::mul(y, left);
    }
    tape.backward(nova::sum(y));
  };
  // y is (3, 4, 3) and (9, 16, 9). Its factor counts as constant.
  const std::vector<float> expected = {3 * 3 * 9, 2 * 4 * 16, 1 * 3 * 9};
  EXPECT_ERROR(iterate(false), ErrorKind::Runtime, "was modified after recording");
  iterate(true);
  EXPECT_EQ(x.grad().to_host(), expected);
  std::shared_ptr<nova::OpList> graph;
  {
    const ScopedCapture capture;
    iterate(true);
    graph = capture.graph();
  }
  for (int k = 0; k < 2; ++k) {
    graph->launch();
    EXPECT_EQ(x.grad().to_host(), expected);
  }
}

}  // namespace
}  // namespace novaphy::testing
