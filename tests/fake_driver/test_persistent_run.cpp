// Persistent kernels on the host. The compiler of this build compiles their text, and their threads
// are fibers that take turns in a random order. Work that no barrier delays runs early, so a
// missing barrier is detected.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <random>

#include "novaphy/nova/kernel.h"
#include "persistent_kernels.h"
#include "persistent_on_host.h"

namespace novaphy::gpu {
namespace {

using nova::Access;
using nova::DType;
using nova::Real;
using nova::TraceContext;
using Form = PersistentShape::Form;

constexpr int32_t kRows = 40, kArrays = 5, kScalars = 2;

// Products that no compiler contracts with the sum that contains them.
float times(float a, float b) {
  const volatile float product = a * b;
  return product;
}

// Arrays of rows of three, scalars, and who is whose neighbor.
struct Memory {
  std::array<std::vector<float>, kArrays> arrays;
  std::array<float, kScalars> scalars{};
  std::vector<int32_t> neighbor, offsets, items;

  explicit Memory(uint32_t seed) : neighbor(kRows), offsets(kRows + 1) {
    std::mt19937 random(seed);
    std::uniform_real_distribution<float> value(-1.0f, 1.0f);
    for (auto& array : arrays) {
      array.resize(3 * kRows);
      for (float& x : array) x = value(random);
    }
    for (float& x : scalars) x = value(random);
    // Some rows have no items, and one has more than a batch.
    for (int32_t i = 0; i < kRows; ++i)
      neighbor[i] = i % 2 == 0 ? 3 : static_cast<int32_t>(random() % kRows);
    for (int32_t row = 0; row < kRows; ++row) {
      for (int32_t i = 0; i < kRows; ++i)
        if (neighbor[i] == row) items.push_back(i);
      offsets[row + 1] = static_cast<int32_t>(items.size());
    }
  }
};

// Operations in phases and chains. One chain of a phase writes an array, and touches it only at its
// own row. Arrays without a writer are read at any row. Each operation is recorded, and run.
class Recorder {
 public:
  Recorder(uint32_t seed, Memory& device, Memory& host)
      : random_(seed), device_(device), host_(host) {
    row_ = traced(nova::make_kernel(
        "row", {{"a", DType::F32, 3, Access::Direct}, {"b", DType::F32, 3, Access::Direct}},
        {{"y", 3}}, [](TraceContext& t) {
          std::vector<Real> y;
          for (int32_t k = 0; k < 3; ++k)
            y.push_back(t.f32(0, k) * Real(0.5f) - t.f32(1, (k + 1) % 3) * Real(0.25f));
          return y;
        }));
    value_ = traced(nova::make_kernel(
        "value", {{"a", DType::F32, 1, Access::Direct}, {"b", DType::F32, 1, Access::Direct}},
        {{"y", 1}}, [](TraceContext& t) {
          return std::vector{t.f32(0) * Real(0.75f) + t.f32(1) * Real(0.125f)};
        }));
    gather_ = traced(nova::make_kernel("gather",
                                       {{"row", DType::I32, 1, Access::Direct},
                                        {"a", DType::F32, 3, Access::Indexed},
                                        {"b", DType::F32, 3, Access::Direct}},
                                       {{"y", 3}}, [](TraceContext& t) {
                                         std::vector<Real> y;
                                         for (int32_t k = 0; k < 3; ++k)
                                           y.push_back(t.f32(1, t.i32(0), k) * Real(0.5f) -
                                                       t.f32(2, k) * Real(0.25f));
                                         return y;
                                       }));
    scale_ = traced(nova::make_kernel(
        "scale", {{"a", DType::F32, 3, Access::Direct}, {"s", DType::F32, 1, Access::Uniform}},
        {{"y", 3}}, [](TraceContext& t) {
          const Real factor = t.f32(1) * t.f32(1);
          return std::vector{t.f32(0, 0) * factor, t.f32(0, 1) * factor, t.f32(0, 2) * factor};
        }));
    collect_ = collect_kernel();
    sum_ = row_sum_kernel();
  }

  const std::vector<novaphy_persistent_op>& record(uint32_t phases) {
    for (uint32_t phase = 0; phase < phases; ++phase) record_phase(phase);
    return recorded_.ops;
  }

 private:
  int32_t below(size_t n) { return static_cast<int32_t>(random_() % n); }
  int32_t one_of(const std::vector<int32_t>& list) { return list[below(list.size())]; }
  static uint64_t word(const void* p) { return reinterpret_cast<uint64_t>(p); }
  uint64_t array(int32_t a) { return word(device_.arrays[a].data()); }

  void record_phase(uint32_t phase) {
    std::vector<int32_t> order(kArrays);
    for (int32_t a = 0; a < kArrays; ++a) order[a] = a;
    std::shuffle(order.begin(), order.end(), random_);
    const int32_t free_scalar = below(kScalars);  // the other one may be written
    size_t next = 0;
    uint32_t chain = 0;
    const std::vector<int32_t> shared(order.end() - 2, order.end());  // arrays without a writer
    while (next < order.size() - shared.size()) {
      const size_t size = std::min<size_t>(1 + below(2), order.size() - shared.size() - next);
      std::vector<int32_t> own(order.begin() + next, order.begin() + next + size);
      next += size;
      if (below(4) == 0) continue;
      std::vector<int32_t> readable = own;
      readable.insert(readable.end(), shared.begin(), shared.end());
      const bool flat = below(4) == 0;  // three rows of values where others have one of three
      const int32_t count = 1 + below(3);
      for (int32_t k = 0; k < count; ++k)
        record_operation(phase, chain, flat, own, readable, shared, free_scalar);
      ++chain;
    }
    if (chain == 0 || below(3) == 0) {
      const int32_t s = 1 - free_scalar;
      const auto value = 0.25f * static_cast<float>(1 + below(4));
      novaphy_persistent_op& o = recorded_.add(phase, chain, 1, 1);
      o.op.target = &device_.scalars[s];
      std::memcpy(&o.op.pattern, &value, sizeof(value));
      host_.scalars[s] = value;
    }
  }

  void record_operation(uint32_t phase, uint32_t chain, bool flat, const std::vector<int32_t>& own,
                        const std::vector<int32_t>& readable, const std::vector<int32_t>& shared,
                        int32_t scalar) {
    const int32_t y = one_of(own), a = one_of(readable), b = one_of(readable);
    const int32_t any = one_of(shared);
    auto& out = host_.arrays[y];
    const auto &x = host_.arrays[a], &z = host_.arrays[b], &other = host_.arrays[any];
    std::vector<float> result(out.size());
    constexpr int64_t kValues = 3 * kRows;
    const auto rows = uint64_t{kRows};
    const auto each_row = [&](const auto& f) {
      for (int32_t i = 0; i < kRows; ++i)
        for (int32_t c = 0; c < 3; ++c) result[3 * i + c] = f(i, c);
    };
    switch (flat ? 0 : below(8)) {
      case 0:
        recorded_.launch(recorded_.add(phase, chain, kValues, flat ? kValues : kRows), value_,
                         {array(a), kValues, array(b), kValues, array(y)});
        for (size_t k = 0; k < result.size(); ++k)
          result[k] = times(x[k], 0.75f) + times(z[k], 0.125f);
        break;
      case 1:
        recorded_.launch(
            recorded_.add(phase, chain, kRows, kRows), gather_,
            {word(device_.neighbor.data()), rows, array(any), rows, array(b), rows, array(y)});
        each_row([&](int32_t i, int32_t c) {
          return times(other[3 * host_.neighbor[i] + c], 0.5f) - times(z[3 * i + c], 0.25f);
        });
        break;
      case 2: {
        recorded_.launch(recorded_.add(phase, chain, kRows, kRows), scale_,
                         {array(a), rows, word(&device_.scalars[scalar]), 1, array(y)});
        const float s = host_.scalars[scalar];
        each_row([&](int32_t i, int32_t c) { return times(x[3 * i + c], times(s, s)); });
        break;
      }
      case 3:
        recorded_.launch(recorded_.add(phase, chain, kRows, kRows), collect_,
                         {array(b), rows, array(any), rows, array(y), word(device_.offsets.data()),
                          word(device_.items.data())});
        each_row([&](int32_t i, int32_t c) { return summed(z[3 * i + c], other, i, c); });
        break;
      case 4: {
        const bool init = below(2) == 0;
        recorded_.launch(recorded_.add(phase, chain, kRows, kRows), sum_,
                         {array(any), word(device_.offsets.data()), word(device_.items.data()),
                          init ? array(b) : 0, array(y), 3, 0});
        each_row(
            [&](int32_t i, int32_t c) { return summed(init ? z[3 * i + c] : 0.0f, other, i, c); });
        break;
      }
      case 5: {
        novaphy_persistent_op& o = recorded_.add(phase, chain, kValues, kRows);
        o.op.target = device_.arrays[y].data();
        if (a != y) o.op.source = device_.arrays[a].data();
        result = a != y ? x : std::vector<float>(out.size(), 0.0f);
        break;
      }
      default:
        recorded_.launch(recorded_.add(phase, chain, kRows, kRows), row_,
                         {array(a), rows, array(b), rows, array(y)});
        each_row([&](int32_t i, int32_t c) {
          return times(x[3 * i + c], 0.5f) - times(z[3 * i + (c + 1) % 3], 0.25f);
        });
    }
    out = result;
  }
  float summed(float sum, const std::vector<float>& from, int32_t i, int32_t c) const {
    for (int32_t k = host_.offsets[i]; k < host_.offsets[i + 1]; ++k)
      sum += from[3 * host_.items[k] + c];
    return sum;
  }

  std::mt19937 random_;
  Memory &device_, &host_;
  novaphy_kernel row_, value_, gather_, scale_, collect_, sum_;
  RecordedPersistent recorded_;
};

struct Case {
  uint32_t seed;
  PersistentShape shape;
};
class RandomPersistent : public testing::TestWithParam<Case> {};

TEST_P(RandomPersistent, HaveTheBitsOfOneOperationAfterTheOther) {
  const auto& [seed, shape] = GetParam();
  Memory device(seed), host(seed);
  Recorder recorder(seed, device, host);
  const auto& ops = recorder.record(16);
  PersistentCapacity capacity;
  if (shape.form != Form::Grid)
    capacity = {shape.blocks * shape.threads / 32 / shape.groups, 40, shape.blocks, shape.groups};
  PersistentTable table = persistent_table(ops, capacity);
  ASSERT_EQ(table.tasks != 0, shape.form != Form::Grid);
  ASSERT_TRUE(shape.form == Form::Grid || most_warps(ops) <= capacity.warps);
  HostPersistent persistent(table, shape);
  EXPECT_TRUE(persistent.run(seed));
  for (int32_t a = 0; a < kArrays; ++a)
    EXPECT_EQ(0, std::memcmp(device.arrays[a].data(), host.arrays[a].data(),
                             host.arrays[a].size() * sizeof(float)))
        << "array " << a;
}

std::vector<Case> cases() {
  std::vector<Case> all;
  for (uint32_t seed = 1; seed <= 3; ++seed) {
    all.push_back({seed, {Form::Block, 1, 32 * 32, 2}});
    all.push_back({seed + 10, {Form::Cluster, 4, 32 * 8, 2}});
    all.push_back({seed + 20, {Form::Grid, 3, 64, 1}});
  }
  return all;
}
INSTANTIATE_TEST_SUITE_P(Seeds, RandomPersistent, testing::ValuesIn(cases()), [](const auto& test) {
  const Form form = test.param.shape.form;
  return std::string(form == Form::Block     ? "Block"
                     : form == Form::Cluster ? "Cluster"
                                             : "Grid") +
         std::to_string(test.param.seed);
});

}  // namespace
}  // namespace novaphy::gpu
