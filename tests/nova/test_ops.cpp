// Functions of tensors: shapes, the order of sums, the data that a tape keeps, and the number of
// Programs.
#include <cmath>
#include <set>

#include "novaphy/nova/gradcheck.h"
#include "novaphy/nova/networks.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/registry.h"
#include "support.h"

namespace novaphy::testing {
namespace {

using nova::Comparison;
using Floats = std::vector<float>;

Tensor weights(const Tensor& like) { return tensor(Random(7).values(like.size()), like.shape()); }

// The gradient of sum(weights * f()) with respect to x.
template <class F>
Floats gradient(const Tensor& x, const F& f) {
  x.zero_grad();
  Tape tape;
  const TapeScope scope(tape);
  const Tensor y = f();
  tape.backward(y, weights(y));
  return x.grad().to_host();
}

TEST(Ops, ASliceMayLieAlongAnyDimensionAndGoBackwards) {
  const Tensor x = Random(1).leaf({2, 4, 3});
  const Floats values = x.to_host();
  const Tensor y = nova::slice(x, 1, 3, 2, -2);
  ASSERT_EQ(y.shape(), (Shape{2, 2, 3}));
  Floats expected, back(24, 0.0f);
  const Floats w = weights(y).to_host();
  for (size_t i = 0; i < 12; ++i) {
    const size_t from = i / 6 * 12 + (3 - 2 * (i % 6 / 3)) * 3 + i % 3;
    expected.push_back(values[from]);
    back[from] = w[i];
  }
  EXPECT_EQ(y.to_host(), expected);
  EXPECT_EQ(gradient(x, [&] { return nova::slice(x, 1, 3, 2, -2); }), back);
}

TEST(Ops, ASliceNamesTheEntriesThatAreNotThere) {
  const Tensor x = tensor({1.0f, 2.0f, 3.0f});
  EXPECT_ERROR(nova::slice(x, 0, 1, 3), ErrorKind::Index,
               "expected entries 0 to 2 along axis 0, got 1 to 3");
  EXPECT_ERROR(nova::slice(x, 0, -1, 1), ErrorKind::Index, "got -1 to -1");
  EXPECT_ERROR(nova::slice(x, 1, 0, 1), ErrorKind::Index, "expected -1 to 0 for shape {3}, got 1");
  EXPECT_ERROR(nova::slice(x, 0, 0, 1, 0), ErrorKind::Value, "step != 0");
  EXPECT_EQ(nova::slice(x, 0, 99, 0).shape(), Shape{0});
}

TEST(Ops, TheGradientOfAGatherAddsInTheOrderOfTheIndex) {
  const Tensor x = Random(2).leaf({3, 2});
  const Tensor index = table({2, 0, 2, 2, 0});
  const Tensor y = nova::gather(x, index);
  Floats expected(6, 0.0f);
  const Floats w = weights(y).to_host();
  const std::vector<int32_t> rows = index.to_host_i32();
  for (size_t i = 0; i < w.size(); ++i)
    expected[static_cast<size_t>(rows[i / 2]) * 2 + i % 2] += w[i];
  EXPECT_EQ(gradient(x, [&] { return nova::gather(x, index); }), expected);
}

TEST(Ops, AGatherRefusesEntriesThatNameNoRow) {
  const Tensor x = Random(2).leaf({3, 2});
  if (!device_context(default_device()).host_accessible)
    GTEST_SKIP() << "a device reports failures when the host waits for it next";
  EXPECT_ERROR(nova::gather(x, table({0, -1})), ErrorKind::Index,
               "gather, index: expected rows 0 to 2 of x, got -1 at entry 1");
  // 2^31 / 2 rows of two values: the product of row and width would wrap around to an existing row.
  EXPECT_ERROR(nova::gather(x, table({INT32_MAX / 2 + 1})), ErrorKind::Index, "at entry 0");
  EXPECT_ERROR(nova::gather(x, x), ErrorKind::Type, "expected int32, got float32");
}

TEST(Ops, ARepetitionIsTheAdjointOfASum) {
  for (const int64_t axis : {0, 1, 2}) {
    const Tensor x = Random(3).leaf({3, 4, 5});
    const Tensor sums = nova::sum(x, axis, true);
    EXPECT_EQ(gradient(x, [&] { return nova::sum(x, axis, true); }),
              nova::broadcast_to(weights(sums), x.shape()).to_host());
    const Tensor one = Random(4).leaf(sums.shape());
    const Tensor spread = nova::broadcast_to(one, x.shape());
    EXPECT_EQ(gradient(one, [&] { return nova::broadcast_to(one, x.shape()); }),
              nova::sum(weights(spread), axis).to_host());
  }
}

TEST(Ops, ASumOverADimensionHasTheOrderOfTheRowSumRule) {
  const Tensor x = Random(5).leaf({600, 2});
  const Floats v = x.to_host();
  Floats expected;
  for (size_t c = 0; c < 2; ++c) {
    float total = 0.0f;
    for (size_t first = 0; first < 600; first += 256) {
      float chunk = 0.0f;
      for (size_t r = first; r < std::min<size_t>(first + 256, 600); ++r) chunk += v[r * 2 + c];
      total += chunk;
    }
    expected.push_back(total);
  }
  EXPECT_EQ(nova::sum(x, 0).to_host(), expected);
}

TEST(Ops, AProductIsALeftFoldAlsoInItsGradients) {
  const Tensor a = Random(6).leaf({3, 300}), b = Random(7).leaf({300, 2});
  const Floats p = a.to_host(), q = b.to_host();
  Floats product(6), to_a(900);
  const Floats w = weights(nova::matmul(a, b)).to_host();
  for (size_t r = 0; r < 3; ++r) {
    for (size_t k = 0; k < 300; ++k) {
      for (size_t c = 0; c < 2; ++c) {
        const float value = p[r * 300 + k] * q[k * 2 + c], back = w[r * 2 + c] * q[k * 2 + c];
        product[r * 2 + c] = product[r * 2 + c] + value;
        to_a[r * 300 + k] = to_a[r * 300 + k] + back;
      }
    }
  }
  EXPECT_EQ(nova::matmul(a, b).to_host(), product);
  EXPECT_EQ(gradient(a, [&] { return nova::matmul(a, b); }), to_a);
}

TEST(Ops, AComparisonCarriesNoGradientAndIsNotRecorded) {
  const Tensor x = Random(8).leaf({5});
  Tape tape;
  const TapeScope scope(tape);
  const Tensor mask = nova::compare(Comparison::Gt, x, 0.0f);
  EXPECT_EQ(tape.size(), 0u);
  const Tensor y = nova::mul(x, mask);
  tape.backward(nova::sum(y));
  EXPECT_EQ(x.grad().to_host(), mask.to_host());
}

TEST(Ops, ACapturedGatherRefusesToRunOnceItsIndexChanged) {
  const Tensor x = Random(9).leaf({4, 2}), index = table({1, 3});
  nova::ScopedCapture capture;
  const Tensor y = nova::gather(x, index);
  capture.end();
  write(x, Random(10).values(8));
  capture.graph()->launch();
  EXPECT_EQ(y.to_host(), nova::gather(x, index).to_host());
  const int32_t other[] = {0, 0};
  index.copy_from_host(other, sizeof(other));
  EXPECT_ANY_THROW(capture.graph()->launch());
}

// Sizes, steps and starts are parameters of the launch.
TEST(Ops, OneProgramServesEveryShape) {
  const auto programs = [] {
    std::set<uint64_t> hashes;
    for (const nova::KernelInfo& info : nova::kernel_info()) hashes.insert(info.hash);
    return hashes;
  };
  const auto use = [](int64_t n, int64_t w) {
    const Tensor x = Random(11).leaf({n, w}), v = Random(12).leaf({w});
    Tape tape;
    const TapeScope scope(tape);
    const Tensor y = nova::gather(nova::add(nova::slice(x, 0, n - 1, n / 2, -2), v), table({0, 0}));
    const Tensor parts[] = {y, nova::slice(x, 0, 1, 1)};
    const Tensor z = nova::matmul(nova::concat(parts), v);
    tape.backward(
        nova::sum(nova::where(nova::compare(Comparison::Lt, z, 0.0f), nova::pow(z, 3.0f), z)));
  };
  use(4, 3);
  const std::set<uint64_t> before = programs();
  use(9, 5);
  EXPECT_EQ(programs(), before);
}

TEST(Ops, GradientsAndTangentsKeepTheDotProductIdentity) {
  const auto function = [](const std::vector<Tensor>& in) {
    const Tensor rows[] = {nova::slice(in[0], 0, 2, 2, -1), nova::gather(in[0], table({1, 1, 0}))};
    const Tensor product = nova::matmul(nova::concat(rows, 0), in[1]);
    const Tensor shifted = nova::add(product, nova::sum(in[1], 0, false));
    return nova::sum(nova::mul(shifted, shifted));
  };
  const auto result =
      nova::gradcheck(function, {Random(3).leaf({3, 4}), Random(4).leaf({4, 2}, 0.5f, 1.5f)});
  EXPECT_TRUE(result.ok) << result.worst;
  EXPECT_TRUE(result.has_tangent);
  EXPECT_LT(result.dot_product_error, 1e-5f);
}

// The backward pass repeats each function of the group, because its value is overwritten
// afterwards.
TEST(Ops, MayStandBetweenCheckpoints) {
  const Tensor index = table({2, 0, 2, 1});
  const Random random(3);
  const auto run = [&](bool recomputed) {
    Random numbers = random;
    const Tensor x = numbers.leaf({3, 4}), w = numbers.leaf({4, 4}), bias = numbers.leaf({4});
    Tape tape;
    const TapeScope scope(tape);
    Tensor values[8];
    {
      const nova::RecomputedScope group(recomputed);
      values[0] = nova::matmul(x, w);
      values[1] = nova::linear(nova::sin(values[0]), w, bias);
      values[2] = nova::gather(nova::sin(values[1]), index);
      values[3] = nova::slice(nova::sin(values[2]), 1, 3, 2, -1);
      const Tensor both[] = {values[3], nova::sin(values[3])};
      values[4] = nova::concat(both, 1);
      values[5] = nova::sum(nova::sin(values[4]), 0);
      values[6] = nova::broadcast_to(nova::sin(values[5]), {3, 4});
      values[7] = nova::sin(values[6]);
    }
    for (size_t k = 0; recomputed && k < 7; ++k) values[k].fill_(0.0f);
    tape.backward(values[7], weights(values[7]));
    Floats gradients;
    for (const Tensor& leaf : {x, w, bias})
      for (const float g : leaf.grad().to_host()) gradients.push_back(g);
    return gradients;
  };
  const Floats expected = run(false);
  EXPECT_TRUE(same_bits<float>(run(true), expected));
  float size = 0.0f;
  for (const float g : expected) size += std::fabs(g);
  EXPECT_GT(size, 0.1f);
}

}  // namespace
}  // namespace novaphy::testing
