// Launches that read the number of their active rows from memory. Values, gradients and replays
// equal those of a launch with only these rows.
#include <algorithm>
#include <cmath>

#include "novaphy/nova/op_list.h"
#include "support.h"
#include "support/threads.h"

namespace novaphy::testing {
namespace {

using nova::make_kernel;
using nova::ScopedCapture;

using Floats = std::vector<float>;

// Computes y = scale * a * sin(x[at]) for the first `count` rows.
class ActiveRows : public ::testing::TestWithParam<int64_t> {
 protected:
  ActiveRows() {
    Random random(3);
    std::vector<int32_t> rows;
    for (int64_t i = 0; i < n; ++i) rows.push_back(random.below(static_cast<int32_t>(n)));
    at = table(rows);
    x = random.leaf({n});
    a = random.leaf({n});
    scale = tensor({1.5f}, true);
  }
  static const Kernel& law() {
    static const Kernel kernel =
        make_kernel("law",
                    {{"at", DType::I32, 1, Access::Direct},
                     {"x", DType::F32, 1, Access::Indexed},
                     {"a", DType::F32, 1, Access::Direct},
                     {"scale", DType::F32, 1, Access::Uniform}},
                    {{"y", 1}}, [](TraceContext& c) {
                      return std::vector{nova::sin(c.f32(1, c.i32(0), 0)) * c.f32(2) * c.f32(3)};
                    });
    return kernel;
  }
  void set_count(int64_t rows) const {
    const auto value = static_cast<int32_t>(rows);
    count.copy_from_host(&value, sizeof(value));
  }
  std::vector<Tensor> leaves() const { return {x, a, scale}; }
  // Returns the results of a launch of the first rows alone.
  std::vector<Floats> alone(int64_t rows) const {
    for (const Tensor& t : leaves()) t.zero_grad();
    std::vector<Floats> all;
    Tape tape;
    const TapeScope scope(tape);
    if (rows > 0) {
      const auto head = [rows](const Tensor& t) {
        Floats v = t.to_host();
        v.resize(static_cast<size_t>(rows));
        return v;
      };
      std::vector<int32_t> few = at.to_host_i32();
      few.resize(static_cast<size_t>(rows));
      const Tensor part = tensor(head(a), true);
      const Tensor few_y = law()(rows, {table(few), x, part, scale})[0];
      tape.backward(nova::sum(nova::mul(few_y, few_y)));
      all = {few_y.to_host(), x.grad().to_host(), part.grad().to_host(), scale.grad().to_host()};
    } else {
      all = {{}, Floats(static_cast<size_t>(n), 0.0f), {}, {0.0f}};
    }
    all[0].resize(static_cast<size_t>(n), 0.0f);
    all[2].resize(static_cast<size_t>(n), 0.0f);
    return all;
  }
  Tensor iterate() const {
    for (const Tensor& t : leaves()) t.zero_grad();
    Tape tape;
    const TapeScope scope(tape);
    const nova::Operand active = count.operand(), out = y.operand();
    const nova::Operand in[] = {at.operand(), x.operand(), a.operand(), scale.operand()};
    y.fill_(0.0f);
    law().launch(n, in, out, {.active = &active});
    const Tensor loss = nova::sum(nova::mul(y, y));
    tape.backward(loss);
    return loss;
  }
  void expect(int64_t rows) const {
    std::vector<Floats> got = {y.to_host()};
    for (const Tensor& t : leaves()) got.push_back(t.grad().to_host());
    const std::vector<Floats> expected = alone(rows);
    for (size_t k = 0; k < got.size(); ++k)
      for (size_t i = 0; i < got[k].size(); ++i)
        ASSERT_NEAR(got[k][i], expected[k][i], 1e-4f * std::max(1.0f, std::abs(expected[k][i])))
            << "array " << k << " row " << i;
  }

  const int64_t n = GetParam();
  const Tensor count{{1}, DType::I32}, y{{n}};
  Tensor at, x, a, scale;
};

TEST_P(ActiveRows, AreComputedAndGiveGradients) {
  for (const int64_t rows : {n / 3, n, n + 5, int64_t{0}, int64_t{-2}, int64_t{1}}) {
    set_count(rows);
    iterate();
    expect(std::clamp<int64_t>(rows, 0, n));
  }
}

TEST_P(ActiveRows, AReplayReadsTheirNumberAnew) {
  for (const int threads : {1, 2, 7}) {
    const Threads of(threads);
    std::shared_ptr<nova::OpList> graph;
    {
      const ScopedCapture capture;
      for (int k = 0; k < 5; ++k) iterate();  // enough for a plan
      graph = capture.graph();
    }
    for (const int64_t rows : {n / 3, int64_t{0}, n, n / 2}) {
      set_count(rows);
      graph->launch();
      graph->prepare();
      expect(rows);
      const Floats replayed = y.to_host(), gradient = x.grad().to_host();
      iterate();
      EXPECT_TRUE(same_bits<float>(y.to_host(), replayed));
      EXPECT_TRUE(same_bits<float>(x.grad().to_host(), gradient));
    }
  }
}

TEST_P(ActiveRows, OthersStayAsTheyAre) {
  set_count(n / 2);
  y.fill_(7.0f);
  const nova::Operand active = count.operand(), out = y.operand();
  const nova::Operand in[] = {at.operand(), x.operand(), a.operand(), scale.operand()};
  law().launch(n, in, out, {.active = &active});
  const Floats rows = y.to_host();
  EXPECT_EQ(rows[static_cast<size_t>(n - 1)], 7.0f);
  EXPECT_NE(rows[0], 7.0f);
}

TEST_P(ActiveRows, MemoryThatTheTapeKnowsIsRefused) {
  set_count(1);
  Tape tape;
  const TapeScope scope(tape);
  const nova::Operand active = count.operand(), out = y.operand();
  const nova::Operand in[] = {at.operand(), x.operand(), a.operand(), scale.operand()};
  law().launch(n, in, out);
  EXPECT_ERROR(law().launch(n, in, out, {.active = &active}), ErrorKind::Runtime,
               "Give it memory of its own");
}

TEST_P(ActiveRows, ANumberThatChangedSinceIsRefused) {
  set_count(1);
  Tape tape;
  const TapeScope scope(tape);
  const nova::Operand active = count.operand(), out = y.operand();
  const nova::Operand in[] = {at.operand(), x.operand(), a.operand(), scale.operand()};
  law().launch(n, in, out, {.active = &active});
  const Tensor loss = nova::sum(y);
  set_count(2);
  EXPECT_ERROR(tape.backward(loss), ErrorKind::Runtime,
               "input 'active' of op 'law' was modified after recording");
}

INSTANTIATE_TEST_SUITE_P(Capacities, ActiveRows, ::testing::Values(40, 70001));

TEST(NumberOfActiveRows, InTheMemoryOfAnOutputIsRefused) {
  static const Kernel twice =
      make_kernel("twice", {{"x", DType::F32, 1, Access::Direct}}, {{"y", 1}},
                  [](TraceContext& c) { return std::vector{c.f32(0) + c.f32(0)}; });
  const Tensor x = tensor({1.0f}), y({1});
  const nova::Operand in = x.operand(), out = y.operand(),
                      active = Tensor(y.range(), y.shape(), DType::I32).operand();
  EXPECT_ERROR(twice.launch(1, in, out, {.active = &active}), ErrorKind::Value,
               "twice: output 'y' overlaps active");
}

TEST(NumberOfActiveRows, OfAKernelWithASumIsRefused) {
  static const Kernel kernel = nova::make_reduce_kernel(
      "total", {{"e", DType::F32, 1, Access::Reduced}}, {{"y", 1}},
      {.init = {}, .body = [](TraceContext& c) { return std::vector{c.f32(0)}; }, .epilogue = {}});
  const Tensor e = tensor({1.0f, 2.0f}), count = table({1}), y({1});
  const nova::Operand in = e.operand(), out = y.operand(), active = count.operand(),
                      wide = table({1, 2}).operand();
  EXPECT_ERROR(kernel.launch(1, in, out, {.extent = 2, .active = &active}), ErrorKind::Value,
               "total, active: expected a kernel without a sum");
  EXPECT_ERROR(kernel.launch(1, in, out, {.extent = 2, .active = &wide}), ErrorKind::Value,
               "total, active: expected {1} int32, got {2} int32");
}

}  // namespace
}  // namespace novaphy::testing
