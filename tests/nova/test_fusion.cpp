// A list of operations that is reordered and run block by block gives the bits of running it as
// written.
#include <array>

#include "novaphy/nova/op_list.h"
#include "support.h"

namespace novaphy::testing {
namespace {

using nova::make_kernel;
using nova::Operand;
using nova::ScopedCapture;

constexpr int64_t kRows = 5003;  // several blocks, the last one not full
constexpr int kArrays = 5, kScalars = 2;

// Arrays of rows of three values, scalars, and random operations between them.
class Workspace {
 public:
  explicit Workspace(uint32_t seed) {
    Random random(seed);
    for (Tensor& t : arrays_) t = tensor(random.values(kRows * 3), {kRows, 3});
    for (Tensor& t : scalars_) t = tensor(random.values(1));
    std::vector<int32_t> rows;
    for (int64_t i = 0; i < kRows; ++i) rows.push_back(random.below(static_cast<int32_t>(kRows)));
    table_ = table(rows);
    incidence_ = nova::make_incidence(table_.operand(), kRows);
  }

  void run_random(uint32_t seed, int count) const {
    Random random(seed);
    for (int k = 0; k < count; ++k) {
      const Tensor &a = array(random), &b = array(random), &y = array(random);
      const Tensor& scalar = scalars_[static_cast<size_t>(random.below(kScalars))];
      switch (random.below(10)) {
        case 0:
          launch(per_value(), kRows * 3, {a.flat_operand(), b.flat_operand()}, y.flat_operand());
          break;
        case 1:
          if (&a != &y)
            launch(gather(), kRows, {table_.operand(), a.operand(), b.operand()}, y.operand());
          break;
        case 2:
          nova::row_sum(a.flat_operand(), 1, kRows * 3, nullptr, scalar.operand());
          break;
        case 3:
          launch(scale(), kRows, {a.operand(), scalar.operand()}, y.operand());
          break;
        case 4:
          nova::submit_fill(random.chance(50) ? y.range() : scalar.range(), 0.5f);
          break;
        case 5:
          if (&a != &y) nova::submit_copy(y.range(), a.range());
          break;
        case 6:
          if (&a != &y) nova::row_sum(a.operand(), *incidence_, nullptr, y.operand());
          break;
        default:
          launch(per_row(), kRows, {a.operand(), b.operand()}, y.operand());
      }
    }
  }

  std::vector<std::vector<float>> values() const {
    std::vector<std::vector<float>> all;
    for (const Tensor& t : arrays_) all.push_back(t.to_host());
    for (const Tensor& t : scalars_) all.push_back(t.to_host());
    return all;
  }

 private:
  static void launch(const Kernel& kernel, int64_t n, std::vector<Operand> in, Operand out) {
    kernel.launch(n, in, {&out, 1});
  }
  const Tensor& array(Random& random) const {
    return arrays_[static_cast<size_t>(random.below(kArrays))];
  }

  static const Kernel& per_row() {
    static const Kernel kernel = make_kernel(
        "per_row", {{"a", DType::F32, 3, Access::Direct}, {"b", DType::F32, 3, Access::Direct}},
        {{"y", 3}}, [](TraceContext& c) {
          std::vector<Real> y;
          for (int32_t k = 0; k < 3; ++k)
            y.push_back(c.f32(0, k) * Real(0.5f) - c.f32(1, (k + 1) % 3));
          return y;
        });
    return kernel;
  }
  static const Kernel& per_value() {
    static const Kernel kernel = make_kernel(
        "per_value", {{"a", DType::F32, 1, Access::Direct}, {"b", DType::F32, 1, Access::Direct}},
        {{"y", 1}}, [](TraceContext& c) {
          return std::vector{c.f32(0) * Real(0.75f) + c.f32(1) * Real(0.125f)};
        });
    return kernel;
  }
  static const Kernel& gather() {
    static const Kernel kernel = make_kernel("gather",
                                             {{"row", DType::I32, 1, Access::Direct},
                                              {"a", DType::F32, 3, Access::Indexed},
                                              {"b", DType::F32, 3, Access::Direct}},
                                             {{"y", 3}}, [](TraceContext& c) {
                                               std::vector<Real> y;
                                               for (int32_t k = 0; k < 3; ++k)
                                                 y.push_back(c.f32(1, c.i32(0), k) - c.f32(2, k));
                                               return y;
                                             });
    return kernel;
  }
  static const Kernel& scale() {
    static const Kernel kernel = make_kernel(
        "scale", {{"a", DType::F32, 3, Access::Direct}, {"s", DType::F32, 1, Access::Uniform}},
        {{"y", 3}}, [](TraceContext& c) {
          std::vector<Real> y;
          for (int32_t k = 0; k < 3; ++k) y.push_back(c.f32(0, k) * nova::sin(c.f32(1)));
          return y;
        });
    return kernel;
  }

  std::array<Tensor, kArrays> arrays_;
  std::array<Tensor, kScalars> scalars_;
  Tensor table_;
  nova::Incidence incidence_;
};

class RandomLists : public ::testing::TestWithParam<uint32_t> {};

TEST_P(RandomLists, ReplayHasTheBitsOfRunningAsWritten) {
  const uint32_t seed = GetParam();
  const Workspace direct(seed), replayed(seed);
  direct.run_random(seed, 60);
  direct.run_random(seed, 60);

  std::shared_ptr<nova::OpList> graph;
  {
    const ScopedCapture capture;
    replayed.run_random(seed, 60);
    graph = capture.graph();
  }
  graph->launch();
  graph->launch();
  const auto expected = direct.values(), got = replayed.values();
  for (size_t k = 0; k < expected.size(); ++k)
    EXPECT_TRUE(same_bits<float>(got[k], expected[k])) << "array " << k;
}

INSTANTIATE_TEST_SUITE_P(Seeds, RandomLists, ::testing::Range(0u, 40u));

}  // namespace
}  // namespace novaphy::testing
