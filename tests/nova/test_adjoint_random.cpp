// Adjoints and tangents of random kernels against the oracle.
#include "novaphy/nova/registry.h"
#include "random_kernel.h"

namespace novaphy::testing {
namespace {

class RandomAdjoints : public ::testing::TestWithParam<SumKind> {};

// Values and gradients in float against double. The comparison has no meaning if a long chain
// amplifies rounding. The forward values show such a case, which is skipped. Most cases must
// remain.
TEST_P(RandomAdjoints, AgreeWithForwardMode) {
  int compared = 0;
  constexpr int kCases = 60;
  for (uint32_t seed = 1; seed <= kCases; ++seed) {
    RandomKernel maker(seed);
    const Call call = maker.call(GetParam(), 4);
    const auto out = call();
    const auto expected = oracle(call.kernel.traced(), oracle_inputs(call));
    bool same_branch = true;
    for (size_t o = 0; o < out.size(); ++o) {
      const auto values = out[o].to_host();
      for (size_t k = 0; k < values.size(); ++k)
        same_branch =
            same_branch && std::fabs(static_cast<double>(values[k]) - expected[o][k].v) < 1e-4;
    }
    if (!same_branch) continue;
    ++compared;
    Seeds seeds = random_seeds(call, maker.random());
    if (seed % 3 == 0) seeds[seed % 2].clear();
    const Gradients gradients = oracle_gradients(call, seeds);
    EXPECT_TRUE(close(tape_gradients(call, seeds, Backward::Each), gradients, 2e-4))
        << "seed " << seed;
    EXPECT_TRUE(close(tape_gradients(call, seeds, Backward::Together), gradients, 2e-4))
        << "seed " << seed;
    EXPECT_TRUE(directions_agree(call, maker.random(), 2e-4)) << "seed " << seed;
    if (HasFailure()) {
      ADD_FAILURE() << nova::ir::to_string(call.kernel.traced());
      return;
    }
  }
  EXPECT_GT(compared, kCases * 9 / 10);
}

// A gated adjoint of all sources gives the values of an adjoint of the wanted sources alone.
TEST_P(RandomAdjoints, HaveTheSameValuesWhereLaunchesOpenGates) {
  for (uint32_t seed = 1; seed <= 30; ++seed) {
    RandomKernel maker(seed);
    const Call call = maker.call(GetParam(), 4);
    nova::AdjointMask mask;
    for (const nova::SourceSpec& s : call.kernel.sources()) {
      mask.wrt.push_back(s.dtype == DType::F32);
      mask.accumulate.push_back(false);
      const Tensor& in = call.inputs[mask.wrt.size() - 1];
      if (mask.wrt.back() && maker.random().chance(30)) in.set_requires_grad(false);
    }
    mask.seeded.assign(call.kernel.outputs().size(), true);
    mask.gated = true;
    Seeds seeds = random_seeds(call, maker.random());
    if (seed % 3 == 0) seeds[seed % 2].clear();
    if (std::none_of(call.inputs.begin(), call.inputs.end(),
                     [](const Tensor& t) { return t.requires_grad(); }))
      continue;
    Call gated = call;
    gated.kernel = nova::with_gradients(RandomKernel(seed).call(GetParam(), 4).kernel, {mask});
    for (const Backward how : {Backward::Each, Backward::Together})
      ASSERT_TRUE(tape_gradients(gated, seeds, how) == tape_gradients(call, seeds, how))
          << "seed " << seed << "\n"
          << nova::ir::to_string(call.kernel.traced());
  }
}

INSTANTIATE_TEST_SUITE_P(Kernels, RandomAdjoints,
                         ::testing::Values(SumKind::None, SumKind::Fixed, SumKind::Csr),
                         [](const auto& test) {
                           return test.param == SumKind::None    ? "Pointwise"
                                  : test.param == SumKind::Fixed ? "FixedSum"
                                                                 : "CsrSum";
                         });

}  // namespace
}  // namespace novaphy::testing
