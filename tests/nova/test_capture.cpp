// Captures: a replay has the bits of direct calls. A call that cannot be recorded is rejected by
// name.
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "novaphy/nova/op_list.h"
#include "novaphy/nova/optim.h"
#include "support.h"

namespace novaphy::testing {
namespace {

using nova::make_kernel;
using nova::OpList;
using nova::ScopedCapture;
using Floats = std::vector<float>;

Floats grad(const Tensor& x) { return x.grad().to_host(); }

// A step with every access kind: rows, a uniform value, neighbors through a table, a sum over CSR
// rows.
class Network {
 public:
  explicit Network(int64_t n) : n_(n) {
    Random random(7);
    std::vector<int32_t> next, row_of;
    for (int64_t i = 0; i < n; ++i) {
      next.push_back(static_cast<int32_t>((i * 7 + 3) % n));
      row_of.push_back(random.below(static_cast<int32_t>(n) + 1) - 1);
      row_of.push_back(random.below(static_cast<int32_t>(n)));
    }
    next_ = table(next);
    edge_ = tensor(random.values(2 * n, -0.5f, 0.5f), true);
    x = tensor(random.values(n), true);
    u = tensor({0.7f}, true);
    row_of_ = table(row_of);
    rows_ = nova::make_incidence(row_of_.operand(), n);
  }

  Tensor loss(int steps = 3) const {
    static const Kernel gather = make_kernel(
        "neighbors",
        {{"next", DType::I32, 1, Access::Direct},
         {"x", DType::F32, 1, Access::Indexed},
         {"u", DType::F32, 1, Access::Uniform}},
        {{"y", 1}}, [](TraceContext& c) {
          const Real near = c.f32(1, c.i32(0), 0);
          return std::vector{nova::sin(near) * c.f32(2) + c.f32(1, c.index(), 0) * Real(0.5f)};
        });
    static const Kernel edges = nova::make_reduce_kernel(
        "edges", {{"x", DType::F32, 1, Access::Direct}, {"e", DType::F32, 1, Access::CsrRow}},
        {{"y", 1}},
        {.init = [](TraceContext& c) { return std::vector{c.f32(0)}; },
         .body = [](TraceContext& c) { return std::vector{c.f32(1) * c.f32(1) * c.f32(0)}; },
         .epilogue = {}});
    Tensor y = x;
    for (int k = 0; k < steps; ++k) {
      y = gather(n_, {next_, y, u})[0];
      y = edges(n_, {y, edge_}, {.csr = &rows_})[0];
    }
    return nova::sum(nova::mul(y, y));
  }
  // One iteration of training; returns the loss.
  Tensor iterate() const {
    Tape tape;
    const TapeScope scope(tape);
    const Tensor l = loss();
    tape.backward(l);
    const float rate = std::min(1e-3f, 0.3f / static_cast<float>(n_));  // larger ones end in NaN
    for (const Tensor& p : {x, u, edge_}) nova::sgd_update_f32(p, rate);
    tape.zero();
    return l;
  }
  std::vector<Floats> parameters() const { return {x.to_host(), u.to_host(), edge_.to_host()}; }

  Tensor x, u;

 private:
  int64_t n_;
  Tensor next_, edge_, row_of_;
  nova::Incidence rows_;
};

// Returns the graph that f records.
template <class F>
std::shared_ptr<OpList> record(const F& f) {
  ScopedCapture capture;
  f();
  return capture.graph();
}

TEST(CaptureReplay, HasTheBitsOfTheEagerLoopOverManyLaunches) {
  for (const int64_t n : {int64_t{1}, int64_t{5}, int64_t{300}, int64_t{2500}}) {
    SCOPED_TRACE(n);
    const Network eager(n), replayed(n);
    const int iterations = n > 1000 ? 5 : 25;
    Tensor loss;
    const auto graph = record([&] { loss = replayed.iterate(); });
    for (int k = 0; k < iterations; ++k) {
      const float expected = eager.iterate().item();
      ASSERT_TRUE(std::isfinite(expected)) << "iteration " << k;
      graph->launch();
      ASSERT_EQ(std::bit_cast<int32_t>(loss.item()), std::bit_cast<int32_t>(expected))
          << "iteration " << k;
      const auto a = eager.parameters(), b = replayed.parameters();
      for (size_t p = 0; p < a.size(); ++p)
        ASSERT_TRUE(same_bits(std::span<const float>(b[p]), std::span<const float>(a[p]))) << k;
    }
  }
}

TEST(CaptureReplay, NothingRunsWhileItIsRecorded) {
  const Tensor x = tensor({1.0f, 2.0f}), y = tensor({9.0f, 9.0f});
  const auto graph = record([&] { y.copy_(nova::mul(x, 2.0f)); });
  EXPECT_EQ(y.to_host(), (Floats{9.0f, 9.0f}));
  EXPECT_GE(graph->size(), 2u);
  graph->launch();
  EXPECT_EQ(y.to_host(), (Floats{2.0f, 4.0f}));
}

TEST(CaptureReplay, ReadsTheValuesOfTheMomentOfTheLaunch) {
  const Tensor x = tensor({1.0f, 2.0f});
  Tensor y;
  const auto graph = record([&] { y = nova::mul(x, x); });
  write(x, {5.0f, 6.0f});
  graph->launch();
  EXPECT_EQ(y.to_host(), (Floats{25.0f, 36.0f}));
}

TEST(CaptureReplay, RaisesTheVersionsOfWhatItWrites) {
  const Tensor x = tensor({1.0f, 2.0f}, true), constant = tensor({3.0f, 3.0f});
  const auto graph = record([&] { x.copy_(constant); });
  Tape tape;
  Tensor loss;
  {
    const TapeScope scope(tape);
    loss = nova::sum(nova::mul(x, x));
  }
  graph->launch();
  EXPECT_ERROR(tape.backward(loss), ErrorKind::Runtime, "was modified after recording");
}

TEST(CaptureReplay, AnEmptyGraphDoesNothing) {
  const auto graph = record([] {});
  EXPECT_EQ(graph->size(), 0u);
  EXPECT_NO_THROW(graph->launch());
}

TEST(CaptureReplay, RecordsTheCustomOperationsOfABackward) {
  const Tensor x = tensor({1.0f, 2.0f}, true);
  const auto iterate = [&] {
    Tape tape;
    const TapeScope scope(tape);
    Tensor y;
    {
      const NoGrad no;
      y = nova::mul(x, x);
    }
    tape.record_custom("square", {x}, {y}, [x](const std::vector<Tensor>& g) {
      return std::vector{nova::mul(nova::mul(g[0], x), 2.0f)};
    });
    tape.zero();
    tape.backward(nova::sum(y));
  };
  const auto graph = record(iterate);
  for (const float v : {3.0f, -4.0f}) {
    write(x, {v, 1.0f});
    graph->launch();
    EXPECT_EQ(grad(x), (Floats{2.0f * v, 2.0f}));
  }
}

// ---- what the gradients of leaves do from launch to launch ----

class CaptureGradients : public ::testing::Test {
 protected:
  Tensor x = tensor({1.0f, -2.0f}, true);
  const Floats once = {2.0f, -4.0f};
  static Floats times(const Floats& g, float a) { return {a * g[0], a * g[1]}; }
  void forward_backward() const {
    Tape tape;
    const TapeScope scope(tape);
    tape.backward(nova::sum(nova::mul(x, x)));
  }
};

TEST_F(CaptureGradients, AccumulateOverLaunchesWithoutZero) {
  const auto graph = record([&] { forward_backward(); });
  EXPECT_EQ(grad(x), (Floats{0.0f, 0.0f}));
  for (int k = 1; k <= 4; ++k) {
    graph->launch();
    EXPECT_EQ(grad(x), times(once, static_cast<float>(k)));
  }
}

TEST_F(CaptureGradients, AreAddedToWhatWasThereBeforeTheCapture) {
  forward_backward();
  const auto graph = record([&] { forward_backward(); });
  EXPECT_EQ(grad(x), once);
  graph->launch();
  EXPECT_EQ(grad(x), times(once, 2.0f));
  forward_backward();
  EXPECT_EQ(grad(x), times(once, 3.0f));
}

TEST_F(CaptureGradients, ZeroedOutsideBetweenLaunchesAreThoseOfOneLaunch) {
  const auto graph = record([&] { forward_backward(); });
  for (int k = 0; k < 3; ++k) {
    x.zero_grad();
    graph->launch();
    EXPECT_EQ(grad(x), once) << k;
  }
  graph->launch();
  EXPECT_EQ(grad(x), times(once, 2.0f));
}

TEST_F(CaptureGradients, ZeroedOutsideBeforeAnEagerBackwardAreStoredAnew) {
  const auto graph = record([&] { forward_backward(); });
  graph->launch();
  x.zero_grad();
  forward_backward();
  EXPECT_EQ(grad(x), once);
  graph->launch();
  EXPECT_EQ(grad(x), times(once, 2.0f));
}

TEST_F(CaptureGradients, ZeroedByTheTapeAtTheEndAreZeroAfterEveryLaunch) {
  Tensor seen(Shape{2});
  const auto graph = record([&] {
    Tape tape;
    const TapeScope scope(tape);
    tape.backward(nova::sum(nova::mul(x, x)));
    nova::Tensor g = x.grad();
    const NoGrad no;
    seen.copy_(g);
    tape.zero();
  });
  for (int k = 0; k < 3; ++k) {
    graph->launch();
    EXPECT_EQ(seen.to_host(), once);
    EXPECT_EQ(grad(x), (Floats{0.0f, 0.0f}));
  }
}

TEST_F(CaptureGradients, ZeroedByTheTapeAtTheStartAreThoseOfOneLaunch) {
  const auto graph = record([&] {
    Tape tape;
    const TapeScope scope(tape);
    const Tensor loss = nova::sum(nova::mul(x, x));
    tape.zero();
    tape.backward(loss);
  });
  for (int k = 0; k < 3; ++k) {
    graph->launch();
    EXPECT_EQ(grad(x), once) << k;
  }
}

TEST_F(CaptureGradients, ZeroedByTheLeafAtTheStartAreThoseOfOneLaunch) {
  for (const bool had_a_gradient : {false, true}) {
    SCOPED_TRACE(had_a_gradient);
    x = tensor({1.0f, -2.0f}, true);
    if (had_a_gradient) forward_backward();
    const auto graph = record([&] {
      x.zero_grad();
      forward_backward();
    });
    for (int k = 0; k < 3; ++k) {
      graph->launch();
      EXPECT_EQ(grad(x), once) << k;
    }
  }
}

TEST_F(CaptureGradients, AreZeroUntilTheFirstLaunchWhateverWasRecorded) {
  // Give the allocator a block that is not zero.
  { const Tensor dirty = tensor({1e9f, 1e9f}); }
  const auto graph = record([&] {
    x.zero_grad();
    forward_backward();
  });
  EXPECT_EQ(grad(x), (Floats{0.0f, 0.0f}));
  forward_backward();
  EXPECT_EQ(grad(x), once);
  graph->launch();
  EXPECT_EQ(grad(x), once);
}

TEST_F(CaptureGradients, TwoBackwardsInOneCaptureAdd) {
  const auto graph = record([&] {
    Tape tape;
    const TapeScope scope(tape);
    const Tensor loss = nova::sum(nova::mul(x, x));
    tape.zero();
    tape.backward(loss);
    tape.backward(loss);
  });
  for (int k = 0; k < 2; ++k) {
    graph->launch();
    EXPECT_EQ(grad(x), times(once, 2.0f));
  }
}

TEST_F(CaptureGradients, TwoIterationsInOneCaptureEqualTwoEagerOnes) {
  const Tensor y = tensor({1.0f, -2.0f}, true);
  const auto iterate = [](const Tensor& p) {
    Tape tape;
    const TapeScope scope(tape);
    tape.backward(nova::sum(nova::mul(p, nova::mul(p, p))));
    nova::sgd_update_f32(p, 0.01f);
    tape.zero();
  };
  const auto graph = record([&] {
    iterate(x);
    iterate(x);
  });
  for (int k = 0; k < 3; ++k) {
    graph->launch();
    iterate(y);
    iterate(y);
    EXPECT_EQ(x.to_host(), y.to_host()) << k;
  }
}

TEST_F(CaptureGradients, OfTwoGraphsAddUpInTheOrderOfTheLaunches) {
  const auto first = record([&] { forward_backward(); });
  const auto second = record([&] {
    Tape tape;
    const TapeScope scope(tape);
    tape.backward(nova::sum(nova::mul(x, 10.0f)));
  });
  first->launch();
  second->launch();
  EXPECT_EQ(grad(x), (Floats{12.0f, 6.0f}));
  second->launch();
  EXPECT_EQ(grad(x), (Floats{22.0f, 16.0f}));
}

TEST_F(CaptureGradients, OfValuesInBetweenAreThoseOfTheLastLaunch) {
  Tensor y;
  const auto graph = record([&] {
    Tape tape;
    const TapeScope scope(tape);
    y = nova::mul(x, x);
    tape.backward(nova::sum(nova::mul(y, y)));
  });
  graph->launch();
  EXPECT_EQ(grad(y), (Floats{2.0f, 8.0f}));
  y.zero_grad();
  write(x, {2.0f, 0.0f});
  graph->launch();
  EXPECT_EQ(grad(y), (Floats{8.0f, 0.0f}));
}

// ---- what is refused ----

class CaptureRefuses : public ::testing::Test {
 protected:
  Tensor x = tensor({1.0f, 2.0f}, true);
  DeviceArray<Vec3f> array{2}, other{2};
};

TEST_F(CaptureRefuses, HostReadsAndUntrackedWritesByName) {
  const ScopedCapture capture;
  const char* why = "inside a ScopedCapture: it cannot be recorded";
  EXPECT_ERROR(x.to_host(), ErrorKind::Runtime, why);
  EXPECT_ERROR(table({1}).to_host_i32(), ErrorKind::Runtime, why);
  EXPECT_ERROR(tensor({1.0f}).item(), ErrorKind::Runtime, "copy_to_host");
  EXPECT_ERROR(write(x, {1.0f, 1.0f}), ErrorKind::Runtime, "copy_from_host inside a ScopedCapture");
  EXPECT_ERROR(array.to_host(), ErrorKind::Runtime, why);
  EXPECT_ERROR(array.zero(), ErrorKind::Runtime, "zero inside a ScopedCapture");
  EXPECT_ERROR(array.fill({1.0f, 1.0f, 1.0f}), ErrorKind::Runtime, "fill inside a ScopedCapture");
  EXPECT_ERROR(array.mutable_data(), ErrorKind::Runtime, "mutable data");
  EXPECT_EQ(capture.graph()->size(), 0u);
}

TEST_F(CaptureRefuses, CopiesOfArraysAreRecorded) {
  array.fill({1.0f, 2.0f, 3.0f});
  DeviceArray<int32_t> ints = DeviceArray<int32_t>::from_host(std::vector<int32_t>{4, 5}), copy(2);
  const auto graph = record([&] {
    other.assign(array);
    copy.assign(ints);
    x.fill_(8.0f);
  });
  EXPECT_EQ(other.to_host()[1], (Vec3f{}));
  EXPECT_EQ(copy.to_host()[1], 0);
  EXPECT_EQ(x.to_host()[0], 1.0f);
  graph->launch();
  EXPECT_EQ(other.to_host()[1], (Vec3f{1.0f, 2.0f, 3.0f}));
  EXPECT_EQ(copy.to_host()[1], 5);
  EXPECT_EQ(x.to_host()[0], 8.0f);
}

TEST_F(CaptureRefuses, AnotherCaptureAndALaunchInside) {
  const auto graph = record([&] { x.fill_(1.0f); });
  const ScopedCapture capture;
  EXPECT_ERROR(ScopedCapture(), ErrorKind::Runtime, "another capture is active");
  EXPECT_ERROR(graph->launch(), ErrorKind::Runtime, "cannot be recorded into another capture");
  EXPECT_ERROR(graph->prepare(), ErrorKind::Runtime, "graph.prepare() inside a ScopedCapture");
  EXPECT_NE(nova::current_capture(), nullptr);
}

TEST_F(CaptureRefuses, ToRunWhileItIsPrepared) {
  const auto graph = record([&] { x.fill_(1.0f); });
  const std::vector<float> before = x.to_host();
  const uint64_t version = x.range()->version();
  graph->prepare();
  EXPECT_EQ(x.to_host(), before);
  EXPECT_EQ(x.range()->version(), version);
  graph->launch();
  EXPECT_EQ(x.to_host()[0], 1.0f);
  record([] {})->prepare();  // nothing is captured
}

TEST_F(CaptureRefuses, ALaunchInsideAnActiveTape) {
  const auto graph = record([&] { x.fill_(1.0f); });
  Tape tape;
  const TapeScope scope(tape);
  EXPECT_ERROR(graph->launch(), ErrorKind::Runtime, "graph.launch() inside an active Tape");
  const NoGrad no;
  EXPECT_NO_THROW(graph->launch());
}

TEST_F(CaptureRefuses, ToFollowAnArrayThatSomebodyElseCanWriteAcrossItsBorder) {
  x.range()->mark_writable_export();
  Tape tape;
  const TapeScope scope(tape);
  const char* message = "writable export cannot be followed into, or out of, a ScopedCapture";
  const Tensor outside = nova::sum(nova::mul(x, x));
  EXPECT_ERROR(record([&] { tape.backward(outside); }), ErrorKind::Runtime, message);
  Tensor inside;
  record([&] { inside = nova::sum(nova::mul(x, x)); });
  EXPECT_ERROR(tape.backward(inside), ErrorKind::Runtime, message);
}

TEST_F(CaptureRefuses, NothingOfAnExportedArrayWhoseForwardAndBackwardAreCapturedTogether) {
  const std::shared_ptr<void> living = x.range()->writable_export_scope();
  const auto graph = record([&] {
    Tape tape;
    const TapeScope scope(tape);
    x.zero_grad();
    tape.backward(nova::sum(nova::mul(x, x)));
  });
  for (const float value : {3.0f, -7.0f}) {  // every launch reads the values written before it
    DeviceContext const& c = device_context(x.device());
    novaphy_error error = make_error();
    ASSERT_EQ(c.api->memory_copy(c.stream, NOVAPHY_COPY_HOST_TO_DEVICE, x.range()->data(), &value,
                                 4, &error),
              NOVAPHY_OK);
    graph->launch();
    EXPECT_EQ(grad(x)[0], 2.0f * value);
  }
}

TEST_F(CaptureRefuses, ALaunchWhileAnotherCallUsesTheSameMemory) {
  const auto memory = std::make_shared<ExclusiveUse>();
  const auto graph = record([&] {
    x.fill_(4.0f);
    nova::current_capture()->uses(memory);
  });
  {
    const ExclusiveUse::Scope taken(*memory, "step", "the solver");
    EXPECT_ERROR(graph->launch(), ErrorKind::Runtime,
                 "graph.launch(): what it was captured from is in use");
    EXPECT_EQ(x.to_host()[0], 1.0f);
  }
  graph->launch();
  EXPECT_EQ(x.to_host()[0], 4.0f);
}

TEST_F(CaptureRefuses, AReplayAfterAnIndexTableWasModified) {
  const Kernel gather = make_kernel(
      "gather", {{"at", DType::I32, 1, Access::Direct}, {"x", DType::F32, 1, Access::Indexed}},
      {{"y", 1}}, [](TraceContext& c) { return std::vector{c.f32(1, c.i32(0), 0)}; });
  const Tensor at = table({1, 1});
  const std::vector<int32_t> other_rows = {0, 1};
  const auto backward = record([&] {
    Tape tape;
    const TapeScope scope(tape);
    tape.backward(nova::sum(gather(2, {at, x})[0]));
  });
  const auto forward = record([&] { gather(2, {at, x}); });
  backward->launch();
  EXPECT_EQ(grad(x), (Floats{0.0f, 2.0f}));
  at.copy_from_host(other_rows.data(), 8);
  EXPECT_ERROR(backward->launch(), ErrorKind::Runtime,
               "an index table (e.g. the contacts) was modified after the capture");
  EXPECT_EQ(grad(x), (Floats{0.0f, 2.0f}));
  EXPECT_NO_THROW(forward->launch());  // depends on no sorted form
}

TEST_F(CaptureRefuses, AReplayAfterTheTableOfACsrSumWasModified) {
  const Kernel csr = nova::make_reduce_kernel(
      "rows", {{"e", DType::F32, 1, Access::CsrRow}}, {{"y", 1}},
      {.init = {}, .body = [](TraceContext& c) { return std::vector{c.f32(0)}; }, .epilogue = {}});
  const Tensor row_of = table({0, 0});
  const nova::Incidence rows = nova::make_incidence(row_of.operand(), 1);
  Tensor y;
  const auto graph = record([&] { y = csr(1, {x}, {.csr = &rows})[0]; });
  graph->launch();
  EXPECT_EQ(y.item(), 3.0f);
  const std::vector<int32_t> changed = {0, -1};
  row_of.copy_from_host(changed.data(), 8);
  EXPECT_ERROR(graph->launch(), ErrorKind::Runtime, "modified after the capture");
}

TEST_F(CaptureRefuses, AnIndexTableThatSomebodyElseCanWrite) {
  const Tensor at = table({0, 1});
  at.range()->mark_writable_export();
  const ScopedCapture capture;
  EXPECT_ERROR(nova::make_incidence(at.operand(), 2), ErrorKind::Runtime,
               "an index table with a writable export");
}

TEST_F(CaptureRefuses, AnExceptionEndsTheCapture) {
  EXPECT_THROW(record([&] { x.to_host(); }), Error);
  EXPECT_EQ(nova::current_capture(), nullptr);
  EXPECT_EQ(array_observer(), nullptr);
  EXPECT_EQ(x.to_host()[0], 1.0f);
}

TEST_F(CaptureRefuses, ARefusedBackwardInsideLeavesTheGradients) {
  {
    Tape tape;
    const TapeScope scope(tape);
    tape.backward(nova::sum(nova::mul(x, 3.0f)));
  }
  const auto graph = record([&] {
    Tape tape;
    const TapeScope scope(tape);
    const Tensor loss = nova::sum(nova::mul(x, x));
    x.fill_(0.0f);
    EXPECT_ERROR(tape.backward(loss), ErrorKind::Runtime, "was modified");
  });
  EXPECT_EQ(grad(x), (Floats{3.0f, 3.0f}));
  EXPECT_EQ(x.to_host()[1], 2.0f);
}

// ---- lifetimes ----

TEST(CaptureLifetime, AGraphOutlivesEverythingThatWasRecorded) {
  std::shared_ptr<OpList> graph;
  Tensor result(Shape{1}), gradient;
  {
    const Network network(300);
    Tensor x = network.x;
    graph = record([&] { result.copy_(network.iterate()); });
    gradient = x.grad();
  }
  release_cached_memory();
  const Tensor churn = Tensor::full({10000}, 3.0f);
  const Network same(300);
  for (int k = 0; k < 3; ++k) {
    graph->launch();
    EXPECT_EQ(result.item(), same.iterate().item()) << k;
  }
}

TEST(CaptureLifetime, AGraphHoldsASourceThatOnlyASumReads) {
  Tensor total;
  std::shared_ptr<OpList> graph;
  {
    const Tensor x = tensor({1.0f, 2.0f, 3.0f, 4.0f});
    graph = record([&] { total = nova::sum(x); });
  }
  // The graph must not read memory that another object gets next.
  std::vector<Tensor> churn;
  for (int k = 0; k < 50; ++k) churn.push_back(Tensor::full({4}, 100.0f));
  graph->launch();
  EXPECT_EQ(total.item(), 10.0f);
}

TEST(CaptureLifetime, KernelsMayGoToo) {
  Tensor y;
  std::shared_ptr<OpList> graph;
  {
    const Kernel kernel =
        make_kernel("short lived", {{"x", DType::F32, 1, Access::Direct}}, {{"y", 1}},
                    [](TraceContext& c) { return std::vector{c.f32(0) + Real(1.0f)}; });
    const Tensor x = tensor({1.0f});
    graph = record([&] { y = kernel(1, {x})[0]; });
  }
  graph->launch();
  EXPECT_EQ(y.item(), 2.0f);
}

TEST(CaptureLifetime, RecordingMayEndEarlyAndTheTapeMayBeginOutside) {
  const Tensor x = tensor({3.0f}, true);
  Tape tape;
  std::optional<TapeScope> scope(std::in_place, tape);
  ScopedCapture capture;
  const Tensor y = nova::mul(x, x);
  capture.end();
  capture.end();
  EXPECT_EQ(nova::mul(x, 2.0f).item(), 6.0f);
  scope.reset();
  EXPECT_EQ(array_observer(), nullptr);
  capture.graph()->launch();
  EXPECT_EQ(y.item(), 9.0f);
}

}  // namespace
}  // namespace novaphy::testing
