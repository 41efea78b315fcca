// A list of operations that is reordered and run block by block gives the bits of the original
// order.
#include <array>

#include "novaphy/core/backend.h"
#include "novaphy/core/parallel.h"
#include "novaphy/nova/op_list.h"
#include "support.h"

namespace novaphy::testing {
namespace {

using nova::make_kernel;
using nova::Operand;
using nova::ScopedCapture;

constexpr int64_t kManyRows = 5003;  // several blocks, the last one not full; phases of threads
constexpr int64_t kFewRows = 331;    // no blocks, and phases of one thread
constexpr int kArrays = 5, kScalars = 2;

// Arrays of rows of three values, scalars, and random operations between them.
class Workspace {
 public:
  Workspace(uint32_t seed, int64_t rows) : rows_(rows) {
    Random random(seed);
    for (Tensor& t : arrays_) t = tensor(random.values(rows_ * 3), {rows_, 3});
    for (Tensor& t : scalars_) t = tensor(random.values(1));
    std::vector<int32_t> named;
    for (int64_t i = 0; i < rows_; ++i) named.push_back(random.below(static_cast<int32_t>(rows_)));
    table_ = table(named);
    incidence_ = nova::make_incidence(table_.operand(), rows_);
  }

  void run_random(uint32_t seed, int count) const {
    Random random(seed);
    nova::rebuild(incidence_);
    for (int k = 0; k < count; ++k) {
      const Tensor &a = array(random), &b = array(random), &y = array(random);
      const Tensor& scalar = scalars_[static_cast<size_t>(random.below(kScalars))];
      switch (random.below(13)) {
        case 0:
          launch(per_value(), rows_ * 3, {a.flat_operand(), b.flat_operand()}, y.flat_operand());
          break;
        case 1:
          if (&a != &y)
            launch(gather(), rows_, {table_.operand(), a.operand(), b.operand()}, y.operand());
          break;
        case 2:
          nova::row_sum(a.flat_operand(), 1, rows_ * 3, nullptr, scalar.operand());
          break;
        case 3:
          launch(scale(), rows_, {a.operand(), scalar.operand()}, y.operand());
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
        case 7:
          launch(find(), rows_, {a.operand()},
                 Tensor(table_.range(), {rows_}, DType::F32).operand());
          break;
        case 8:
          nova::rebuild(incidence_);
          break;
        case 9:
          if (&a != &y) launch(add(), rows_, {b.operand(), a.operand()}, y.operand(), &incidence_);
          break;
        default:
          launch(per_row(), rows_, {a.operand(), b.operand()}, y.operand());
      }
    }
  }

  std::vector<std::vector<float>> values() const {
    std::vector<std::vector<float>> all;
    for (const Tensor& t : arrays_) all.push_back(t.to_host());
    for (const Tensor& t : scalars_) all.push_back(t.to_host());
    all.push_back(Tensor(table_.range(), {rows_}, DType::F32).to_host());
    return all;
  }

 private:
  static void launch(const Kernel& kernel, int64_t n, std::vector<Operand> in, Operand out,
                     const nova::Incidence* csr = nullptr) {
    kernel.launch(n, in, out, {.csr = csr});
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
  // Row indices for the table, as the bits of floats; some entries are no row.
  const Kernel& find() const {
    static std::map<int64_t, Kernel> kernels;
    const auto [known, fresh] = kernels.try_emplace(rows_);
    const auto rows = static_cast<int32_t>(rows_);
    if (fresh)
      known->second = make_kernel(
          "find", {{"a", DType::F32, 3, Access::Direct}}, {{"row", 1}}, [rows](TraceContext& c) {
            const Int row = nova::to_int(nova::abs(c.f32(0, 1)) * Real(977.0f)) % Int(rows);
            return std::vector{
                nova::bits_float(nova::select(row % Int(5) == Int(0), Int(-1), row))};
          });
    return known->second;
  }
  static const Kernel& add() {
    static const Kernel kernel = nova::make_reduce_kernel(
        "add", {{"init", DType::F32, 3, Access::Direct}, {"item", DType::F32, 3, Access::CsrRow}},
        {{"y", 3}},
        {.init =
             [](TraceContext& c) {
               return std::vector{c.f32(0, 0), c.f32(0, 1), c.f32(0, 2)};
             },
         .body =
             [](TraceContext& c) {
               return std::vector{c.f32(1, 0), c.f32(1, 1), c.f32(1, 2)};
             },
         .epilogue = {}});
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

  const int64_t rows_;
  std::array<Tensor, kArrays> arrays_;
  std::array<Tensor, kScalars> scalars_;
  Tensor table_;
  nova::Incidence incidence_;
};

class RandomLists : public ::testing::TestWithParam<uint32_t> {
 protected:
  // Two runs as written, and as many replays.
  static void compare(uint32_t seed, int64_t rows, int first_threads, int second_threads) {
    const Workspace direct(seed, rows), replayed(seed, rows);
    direct.run_random(seed, 60);
    direct.run_random(seed, 60);

    std::shared_ptr<nova::OpList> graph;
    {
      const ScopedCapture capture;
      replayed.run_random(seed, 60);
      graph = capture.graph();
    }
    set_num_threads(first_threads);
    graph->launch();  // on a GPU this may be the plain graph still
    set_num_threads(second_threads);
    graph->prepare();
    graph->launch();
    const auto expected = direct.values(), got = replayed.values();
    for (size_t k = 0; k < expected.size(); ++k)
      EXPECT_TRUE(same_bits<float>(got[k], expected[k])) << "array " << k;
  }
  void TearDown() override { set_num_threads(before_); }
  const int before_ = num_threads();
};

TEST_P(RandomLists, ReplayHasTheBitsOfRunningAsWritten) {
  compare(GetParam(), kManyRows, before_, before_);
  compare(GetParam(), kManyRows, 2, 7);
  compare(GetParam(), kManyRows, 7, 2);
}
TEST_P(RandomLists, OfFewRowsToo) {
  compare(GetParam(), kFewRows, 2, 7);
  compare(GetParam(), kFewRows, 7, 2);
  compare(GetParam(), kFewRows, 1, 3);
}

INSTANTIATE_TEST_SUITE_P(Seeds, RandomLists, ::testing::Range(0u, 40u));

// Elements and their neighbors read each other in turns, so the list has phases. One index of the
// table is too large.
TEST(Phased, AFailureIsThatOfTheLaunchThatWasRecordedFirst) {
  if (!device_context(tensor({0.0f}).range()->storage().device()).host_accessible)
    GTEST_SKIP() << "a device reports failures when the host waits for it next";
  const auto reader = [](const char* name) {
    return make_kernel(
        name, {{"row", DType::I32, 1, Access::Direct}, {"a", DType::F32, 1, Access::Indexed}},
        {{"y", 1}}, [](TraceContext& c) { return std::vector{c.f32(1, c.i32(0), 0)}; });
  };
  const Kernel kernels[] = {reader("first_reader"), reader("second_reader")};
  constexpr int32_t kRows = 100000;  // shared by as many threads as launch it first
  std::vector<int32_t> rows;
  for (int32_t i = 0; i < kRows; ++i) rows.push_back(kRows - 1 - i);
  rows[277] = 500000;
  const Tensor good = table(std::vector<int32_t>(kRows, 0)), bad = table(rows);
  const std::vector<float> zeros(kRows, 0.0f);
  const Tensor a = tensor(zeros), b = tensor(zeros), c = tensor(zeros);
  ScopedCapture capture;
  const auto launch = [&](const Kernel& kernel, const Tensor& at, const Tensor& from,
                          const Tensor& to) {
    const Operand in[] = {at.operand(), from.operand()}, out = to.operand();
    kernel.launch(kRows, in, out);
  };
  for (int k = 0; k < 10; ++k) {
    launch(kernels[0], good, a, b);
    launch(kernels[1], good, b, a);
  }
  launch(kernels[1], bad, a, b);  // these two are one phase
  launch(kernels[0], bad, a, c);
  launch(kernels[0], bad, b, a);
  const auto graph = capture.graph();
  capture.end();
  const int before = num_threads();
  for (const int threads : {7, 2, 1}) {
    set_num_threads(threads);
    try {
      graph->launch();
      ADD_FAILURE() << "no error";
    } catch (const Error& error) {
      EXPECT_STREQ(error.what(),
                   "second_reader: kernel 'second_reader': row i = 277 reads row 500000 of source "
                   "'a', which has 100000 rows");
    }
  }
  set_num_threads(before);
}

}  // namespace
}  // namespace novaphy::testing
