// A tape that keeps only the gradients of leaves: the gradients have the same bits, and a read of
// another gradient is an error.
#include <array>
#include <cmath>
#include <thread>

#include "novaphy/nova/op_list.h"
#include "novaphy/nova/registry.h"
#include "support.h"

namespace novaphy::testing {
namespace {

using nova::KeepGradients;
using nova::ScopedCapture;
using Floats = std::vector<float>;

// A chain whose every value meets the loss too, with values that are read several times.
struct Chain {
  Tensor x, start = tensor({0.25f, -0.5f, 2.0f}, true);
  std::vector<Tensor> values;
  Tensor loss;
  Chain() : x(tensor({1.0f, -2.0f, 3.0f}, true)) {}
  void record() {
    Tensor y = x;
    Tensor total = nova::mul(start, 1.0f);
    for (int k = 0; k < 9; ++k) {
      y = nova::mul(nova::sin(y), nova::add(x, y));
      values.push_back(y);
      total = nova::add(total, nova::mul(y, start));
    }
    loss = nova::dot(total, values[4]);
  }
  std::vector<Floats> gradients() const { return {x.grad().to_host(), start.grad().to_host()}; }
};

std::vector<Floats> gradients(KeepGradients keep, int backwards = 1) {
  Chain chain;
  Tape tape(keep);
  const TapeScope scope(tape);
  chain.record();
  for (int k = 0; k < backwards; ++k) tape.backward(chain.loss);
  return chain.gradients();
}

TEST(LeafGradients, HaveTheBitsOfATapeThatKeepsAll) {
  for (const int backwards : {1, 2}) {
    const auto all = gradients(KeepGradients::All, backwards);
    const auto leaves = gradients(KeepGradients::Leaves, backwards);
    for (size_t k = 0; k < all.size(); ++k)
      EXPECT_TRUE(same_bits<float>(leaves[k], all[k])) << backwards << " " << k;
  }
}

// Elements compute terms for their corners, and each row sums its terms. The next step reads the
// sums. `terms_too`: the loss reads the terms as well. `copied`: the gradient of the sums was
// written for every corner.
struct ElementGradients {
  std::vector<Floats> values;
  bool copied = false;
};
ElementGradients element_gradients(KeepGradients keep, bool terms_too) {
  const Kernel pull = nova::make_kernel("pull",
                                        {{"corners", DType::I32, 2, Access::Direct},
                                         {"x", DType::F32, 3, Access::Indexed},
                                         {"stiffness", DType::F32, 1, Access::Direct}},
                                        {{"pulls", 6}}, [](TraceContext& c) {
                                          std::vector<Real> out;
                                          for (int32_t k = 0; k < 2; ++k)
                                            for (int32_t d = 0; d < 3; ++d) {
                                              const Real a = c.f32(1, c.i32(0, k), d),
                                                         b = c.f32(1, c.i32(0, 1 - k), d);
                                              out.push_back(c.f32(2) * (b - a) * a);
                                            }
                                          return out;
                                        });
  const Kernel add_up = nova::make_reduce_kernel(
      "add_up", {{"x", DType::F32, 3, Access::Direct}, {"pulls", DType::F32, 3, Access::CsrRow}},
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
  constexpr int64_t kElements = 40, kRows = 23;
  std::vector<int32_t> corners;
  Floats start, stiffness;
  for (int64_t e = 0; e < kElements; ++e)
    for (const int64_t row : {e % kRows, (5 * e + 2) % (kRows + 2) - 2})
      corners.push_back(static_cast<int32_t>(row));
  for (int64_t k = 0; k < 3 * kRows; ++k) start.push_back(0.3f * std::sin(static_cast<float>(k)));
  for (int64_t e = 0; e < kElements; ++e) stiffness.push_back(0.1f * static_cast<float>(e % 7 + 1));
  const Tensor table = Tensor::from_host(std::span<const int32_t>(corners), {kElements, 2});
  Tensor first = Tensor::from_host(std::span<const float>(start), {kRows, 3});
  Tensor k = Tensor::from_host(std::span<const float>(stiffness), {kElements});
  first.set_requires_grad(true), k.set_requires_grad(true);
  Tape tape(keep);
  const TapeScope scope(tape);
  Tensor x = first, pulls, other;
  for (int step = 0; step < 3; ++step) {
    pulls = pull(kElements, {table, x, k})[0];
    if (terms_too) other = nova::mul(pulls, pulls);
    nova::Operand terms = pulls.operand();
    terms.rows = 2 * kElements, terms.width = 3;
    const Tensor y({kRows, 3});
    const nova::Operand in[] = {x.operand(), terms}, out = y.operand();
    const nova::Incidence rows = nova::make_incidence(table.operand(), kRows);
    add_up.launch(kRows, in, out, {.csr = &rows});
    x = y;
  }
  Tensor loss = nova::dot(x, x);
  if (terms_too) loss = nova::add(loss, nova::dot(other, pulls));
  tape.backward(loss);
  const std::vector<nova::KernelInfo> used = nova::kernel_info();
  return {{first.grad().to_host(), k.grad().to_host()},
          std::any_of(used.begin(), used.end(), [](const nova::KernelInfo& info) {
            return info.name == "add_up.adjoint_items";
          })};
}

// The adjoint of the elements then reads the gradient of the sums, without a copy for each corner.
TEST(LeafGradients, OfElementsAreReadThroughTheirTable) {
  for (const bool terms_too : {false, true}) {
    const ElementGradients all = element_gradients(KeepGradients::All, terms_too);
    const ElementGradients leaves = element_gradients(KeepGradients::Leaves, terms_too);
    EXPECT_TRUE(all.copied);
    EXPECT_EQ(leaves.copied, terms_too);
    for (size_t k = 0; k < all.values.size(); ++k)
      EXPECT_TRUE(same_bits<float>(leaves.values[k], all.values[k])) << terms_too << " " << k;
  }
}

// A row of three columns, two of them from parameters, and two values computed from the row.
struct Materials {
  const Kernel assign = nova::make_kernel(
      "assign_row",
      {{"base", DType::F32, 1, Access::Direct}, {"parameters", DType::F32, 2, Access::Direct}},
      {{"row", 3}}, [](TraceContext& c) {
        return std::vector{c.f32(1, 0) * 2.0f, c.f32(1, 1) * c.f32(1, 1), c.f32(0, 0)};
      });
  const Kernel respond = nova::make_kernel(
      "respond", {{"row", DType::F32, 3, Access::Direct}, {"x", DType::F32, 1, Access::Direct}},
      {{"y", 1}}, [](TraceContext& c) {
        const Real at = c.f32(1);
        return std::vector{c.f32(0, 0) * at + c.f32(0, 1) * sin(at) + cos(c.f32(0, 2) * at)};
      });
  Tensor base = tensor({0.5f, -1.0f, 2.0f, 0.25f}), x = tensor({1.0f, 0.5f, -2.0f, 3.0f}, true),
         parameters = Tensor::from_host(
             std::span<const float>(Floats{1.0f, 2.0f, -3.0f, 0.5f, 0.1f, 4.0f, -0.7f, 1.5f}),
             {4, 2});
  Materials() { parameters.set_requires_grad(true); }
  // `flat`: another operation reads all columns, one after the other. `copied`: the row is copied
  // to other memory before it is read.
  std::vector<Floats> gradients(KeepGradients keep, bool flat, bool copied) {
    for (Tensor* leaf : {&parameters, &x, &base}) leaf->zero_grad();
    Tape tape(keep);
    const TapeScope scope(tape);
    Tensor row = assign(4, {base, parameters})[0];
    if (copied) {
      const Tensor other(row.shape());
      other.copy_(row);
      row = other;
    }
    const Tensor y = respond(4, {row, x})[0], z = respond(4, {row, y})[0];
    Tensor loss = nova::dot(z, y);
    if (flat) loss = nova::add(loss, nova::dot(row, row));
    tape.backward(loss);
    std::vector<Floats> all = {parameters.grad().to_host(), x.grad().to_host()};
    if (base.requires_grad()) all.push_back(base.grad().to_host());
    return all;
  }
  // The adjoint of `respond` that leaves out the last column, and adds to the gradient of the row.
  uint64_t hash_of_narrow() const {
    nova::AdjointMask mask = nova::gradient_mask(respond, {"row", "x"}, {"row"}, {"y"});
    const size_t whole = respond.adjoint(mask).rows[0].program.instrs.size();
    mask.narrowed = 0;
    mask.unread = 4;
    const ir::Program& narrow = respond.adjoint(mask).rows[0].program;
    EXPECT_LT(narrow.instrs.size(), whole);
    return ir::hash(narrow);
  }
  static bool was_used(uint64_t hash) {
    const std::vector<nova::KernelInfo> used = nova::kernel_info();
    return std::any_of(used.begin(), used.end(),
                       [hash](const nova::KernelInfo& info) { return info.hash == hash; });
  }
};

TEST(LeafGradients, LeaveOutColumnsThatNobodyReads) {
  for (const bool base_too : {true, false})
    for (const bool flat : {false, true})
      for (const bool copied : {false, true}) {
        Materials materials;
        materials.base.set_requires_grad(base_too);
        const std::vector<Floats> all = materials.gradients(KeepGradients::All, flat, copied);
        EXPECT_FALSE(Materials::was_used(materials.hash_of_narrow()));
        const std::vector<Floats> leaves = materials.gradients(KeepGradients::Leaves, flat, copied);
        if (!flat) {
          EXPECT_EQ(Materials::was_used(materials.hash_of_narrow()), !base_too);
        }
        for (size_t k = 0; k < all.size(); ++k)
          EXPECT_TRUE(same_bits<float>(leaves[k], all[k]))
              << base_too << " " << flat << " " << copied << " " << k;
      }
}

// Compares the gradients of `read` over rows of Materials and numbers, with tables if it has some.
void expect_the_bits_of_all(const char* what, const Kernel& read,
                            const std::vector<std::vector<int32_t>>& tables, int64_t rows) {
  const Kernel assign = Materials().assign;
  const int64_t n = tables.empty() ? rows : static_cast<int64_t>(tables[0].size());
  const auto numbers = [](int64_t count, float step) {
    Floats values;
    for (int64_t k = 0; k < count; ++k)
      values.push_back(std::sin(step * static_cast<float>(k + 1)));
    return values;
  };
  std::vector<Floats> found;
  for (const KeepGradients keep : {KeepGradients::All, KeepGradients::Leaves}) {
    const Tensor base = tensor(numbers(rows, 1.7f)), weights = tensor(numbers(n, 2.3f));
    const Tensor parameters =
        Tensor::from_host(std::span<const float>(numbers(2 * rows, 0.9f)), {rows, 2});
    parameters.set_requires_grad(true);
    Tape tape(keep);
    const TapeScope scope(tape);
    std::vector<Tensor> in;
    for (const std::vector<int32_t>& table : tables)
      in.push_back(Tensor::from_host(std::span<const int32_t>(table), {n}));
    in.push_back(assign(rows, {base, parameters})[0]);
    in.push_back(weights);
    const Tensor y = read(n, in)[0];
    tape.backward(nova::dot(y, y));
    found.push_back(parameters.grad().to_host());
  }
  EXPECT_TRUE(same_bits<float>(found[1], found[0])) << what;
}

// Adding in another order would round elsewhere.
TEST(LeafGradients, LeavingOutColumnsKeepsTheOrderOfAdditions) {
  const Kernel choices = nova::make_kernel(
      "choices", {{"row", DType::F32, 3, Access::Direct}, {"w", DType::F32, 1, Access::Direct}},
      {{"y", 4}}, [](TraceContext& c) {
        const Real w = c.f32(1), v = c.f32(0, 0) * w;
        const nova::Bool first = w < Real(5.0f), second = w < Real(6.0f);
        const Real a = select(first, v * 0.3f, Real(0.7f)),
                   b = select(second, v * 0.7f, Real(0.2f)),
                   other = select(first, c.f32(0, 2) * 0.9f, Real(0.1f));
        return std::vector{v * 0.1f, a, b, other};
      });
  expect_the_bits_of_all("choices", choices, {}, 64);
  const Kernel through = nova::make_kernel(
      "through_tables",
      {{"t", DType::I32, 1, Access::Direct},
       {"u", DType::I32, 1, Access::Direct},
       {"row", DType::F32, 3, Access::Indexed},
       {"w", DType::F32, 1, Access::Direct}},
      {{"y", 1}}, [](TraceContext& c) {
        const Real w = c.f32(3);
        const Real a = c.f32(2, c.i32(0), 2), b = c.f32(2, c.i32(1), 0), d = c.f32(2, c.i32(0), 0);
        return std::vector{a * w + b * w * w + d * cos(w)};
      });
  std::vector<std::vector<int32_t>> tables(2);
  for (int32_t k = 0; k < 64; ++k) {
    tables[0].push_back(k * 7 % 11 % 4);
    tables[1].push_back(k * 5 % 13 % 4);
  }
  expect_the_bits_of_all("tables", through, tables, 4);
}

// Terms that their sum also reads at its own row.
TEST(LeafGradients, OfTermsThatTheSumReadsTwiceAreWhole) {
  const Kernel give = nova::make_kernel(
      "give", {{"t", DType::I32, 1, Access::Direct}, {"x", DType::F32, 1, Access::Direct}},
      {{"terms", 1}}, [](TraceContext& c) { return std::vector{c.f32(1) * 2.0f}; });
  const Kernel sum = nova::make_reduce_kernel(
      "sum_and_own",
      {{"terms", DType::F32, 1, Access::CsrRow}, {"own", DType::F32, 1, Access::Direct}},
      {{"y", 1}},
      {.init = [](TraceContext& c) { return std::vector{c.f32(1)}; },
       .body = [](TraceContext& c) { return std::vector{c.f32(0)}; },
       .epilogue = {}});
  for (const KeepGradients keep : {KeepGradients::All, KeepGradients::Leaves}) {
    const Tensor x = tensor({1.0f, 2.0f, 3.0f, 4.0f}, true);
    const Tensor table =
        Tensor::from_host(std::span<const int32_t>(std::vector<int32_t>{1, 2, 0, 0}), {4});
    Tape tape(keep);
    const TapeScope scope(tape);
    const Tensor terms = give(4, {table, x})[0];
    const nova::Incidence rows = nova::make_incidence(table.operand(), 4);
    const Tensor y = sum(4, {terms, terms}, {.csr = &rows})[0];
    tape.backward(nova::dot(y, tensor({1.0f, 10.0f, 100.0f, 1000.0f})));
    EXPECT_EQ(x.grad().to_host(), (Floats{22.0f, 220.0f, 202.0f, 2002.0f}));
  }
}

TEST(LeafGradients, ReadingAnotherGradientIsRefusedUntilItIsZeroOrKept) {
  Chain chain;
  Tape tape(KeepGradients::Leaves);
  const TapeScope scope(tape);
  chain.record();
  EXPECT_EQ(chain.values[3].grad().to_host(), Floats(3, 0.0f));  // nothing was computed yet
  tape.backward(chain.loss);
  for (const Tensor& value : {chain.values[0], chain.values[8], chain.loss}) {
    try {
      value.grad();
      ADD_FAILURE() << "a gradient that was not kept was given";
    } catch (const Error& error) {
      EXPECT_NE(std::string(error.what()).find("leaves only"), std::string::npos);
    }
  }
  tape.zero();
  EXPECT_EQ(chain.values[0].grad().to_host(), Floats(3, 0.0f));
}

TEST(LeafGradients, TakeNoMemoryForOtherValues) {
  Chain chain;
  Tape tape(KeepGradients::Leaves);
  const TapeScope scope(tape);
  chain.record();
  tape.backward(chain.loss);
  for (const Tensor& value : chain.values) EXPECT_EQ(nova::grad_info(*value.range()).grad, nullptr);
  EXPECT_NE(nova::grad_info(*chain.x.range()).grad, nullptr);
}

TEST(LeafGradients, ARangeThatIsWrittenSeveralTimesKeepsItsValuesApart) {
  static const Kernel kernel =
      nova::make_kernel("scale", {{"x", DType::F32, 1, Access::Direct}}, {{"out", 1}},
                        [](TraceContext& c) { return std::vector{c.f32(0) * c.param(0)}; });
  const auto scale = [](const Tensor& out, const Tensor& in, float a) {
    const nova::Operand from = in.operand(), to = out.operand();
    const Param params[] = {a};
    kernel.launch(in.rows(), from, to, {.params = params});
  };
  for (const KeepGradients keep : {KeepGradients::All, KeepGradients::Leaves}) {
    const Tensor x = tensor({1.0f, 2.0f, 3.0f}, true), a = tensor({0, 0, 0}), b = tensor({0, 0, 0});
    Tape tape(keep);
    const TapeScope scope(tape);
    scale(a, x, 3.0f);
    scale(b, a, 5.0f);
    scale(a, b, 7.0f);  // another value of a
    tape.backward(nova::sum(nova::add(a, b)));
    EXPECT_EQ(x.grad().to_host(), Floats(3, 3.0f * 5.0f * (1.0f + 7.0f)));
  }
}

TEST(LeafGradients, OfACustomOperationAreHandedOnAndNotKept) {
  const Tensor x = tensor({1.0f, -2.0f, 3.0f}, true);
  Tape tape(KeepGradients::Leaves);
  const TapeScope scope(tape);
  const Tensor y = nova::mul(x, 2.0f);
  Tensor z;
  {
    const NoGrad no_grad;
    z = nova::mul(y, 10.0f);
  }
  tape.record_custom("ten_times", {y}, {z}, [](const std::vector<Tensor>& grads) {
    return std::vector{nova::mul(grads[0], 10.0f)};
  });
  tape.backward(nova::sum(nova::mul(z, z)));
  EXPECT_EQ(x.grad().to_host(), (Floats{800.0f, -1600.0f, 2400.0f}));
  EXPECT_THROW(z.grad(), Error);
}

TEST(LeafGradients, OfAGraphAreThoseOfEagerRunsAndGraphsShareNoMemory) {
  const auto expected = gradients(KeepGradients::All);
  std::array<Chain, 2> chains;
  std::array<std::shared_ptr<nova::OpList>, 2> graphs;
  for (size_t k = 0; k < 2; ++k) {
    ScopedCapture capture;
    Tape tape(KeepGradients::Leaves);
    {
      const TapeScope scope(tape);
      chains[k].record();
      chains[k].x.zero_grad();
      chains[k].start.zero_grad();
      tape.backward(chains[k].loss);
    }
    graphs[k] = capture.graph();
  }
  std::array<std::thread, 2> threads;
  for (size_t k = 0; k < 2; ++k)
    threads[k] = std::thread([&, k] {
      for (int i = 0; i < 200; ++i) graphs[k]->launch();
    });
  for (std::thread& thread : threads) thread.join();
  for (const Chain& chain : chains) {
    const auto actual = chain.gradients();
    for (size_t k = 0; k < actual.size(); ++k)
      EXPECT_TRUE(same_bits<float>(actual[k], expected[k]));
    EXPECT_THROW(chain.values[0].grad(), Error);
  }
}

TEST(LeafGradients, AreAsBeforeWhenBackwardIsRefused) {
  Chain chain;
  Tape tape(KeepGradients::Leaves);
  const TapeScope scope(tape);
  chain.record();
  tape.backward(chain.loss);
  const auto before = chain.gradients();
  write(chain.x, {9.0f, 9.0f, 9.0f});
  EXPECT_THROW(tape.backward(chain.loss), Error);
  EXPECT_EQ(chain.gradients(), before);
  EXPECT_THROW(chain.values[0].grad(), Error);
}

}  // namespace
}  // namespace novaphy::testing
