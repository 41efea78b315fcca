// The adjoint dot-product identity <J u, w> = <u, J^T w> for every kernel of the engine, at random
// inputs. The test covers new operators without a change.
#include <set>

#include "engine_calls.h"

namespace novaphy::testing {
namespace {

bool finite(const std::vector<Tensor>& tensors) {
  for (const Tensor& t : tensors)
    for (const float x : t.to_host())
      if (!std::isfinite(x)) return false;
  return true;
}

TEST(EngineKernels, KeepTheDotProductIdentity) {
  std::set<std::string> names;
  for (const nova::EngineKernel& k : all_kernels()) {
    if (k.gradients.empty()) continue;  // part of a backward or of an optimizer
    names.insert(k.kernel.name());
    int compared = 0;
    for (uint32_t seed = 1; seed <= 5; ++seed) {
      const Call call = random_call(k.kernel, seed);
      bool carries = false;
      for (const Tensor& t : call.inputs) carries = carries || t.requires_grad();
      if (!carries || !finite(call())) continue;
      ++compared;
      Random random(seed + 100);
      EXPECT_TRUE(directions_agree(call, random, 3e-4)) << k.kernel.name() << ", seed " << seed;
    }
    EXPECT_GT(compared, 0) << k.kernel.name();
  }
  EXPECT_TRUE(names.contains("integrate_particles"));
}

// A part of the compiled gradients uses the adjoint of all of them. The signs of zeros may differ.
TEST(EngineKernels, GiveTheSameGradientsWhateverElseIsAskedFor) {
  int parts = 0;
  for (const nova::EngineKernel& k : all_kernels()) {
    if (k.gradients.empty()) continue;
    const Call call = random_call(k.kernel, 3);
    if (!finite(call())) continue;
    const std::vector<bool> all(call.inputs.size(), true);
    Random random(11);
    for (uint32_t seeded = 1; seeded < uint32_t{1} << k.kernel.outputs().size(); ++seeded)
      for (const nova::AdjointMask& mask : k.gradients) {
        std::vector<bool> some = mask.wrt;
        for (size_t s = 0; s < some.size(); ++s) some[s] = some[s] && random.chance(60);
        if (std::count(some.begin(), some.end(), true) == 0) continue;
        const auto expected = gradients(call, all, seeded, nova::KeepGradients::All);
        for (const auto keep : {nova::KeepGradients::All, nova::KeepGradients::Leaves})
          for (const auto& [s, values] : gradients(call, some, seeded, keep)) {
            ASSERT_EQ(values, expected.at(s))
                << k.kernel.name() << ", " << k.kernel.sources()[s].name << ", outputs " << seeded;
            ++parts;
          }
      }
  }
  EXPECT_GT(parts, 300);
}

}  // namespace
}  // namespace novaphy::testing
