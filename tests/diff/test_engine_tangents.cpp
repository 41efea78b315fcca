// The adjoint dot-product identity <J u, w> = <u, J^T w> for every kernel of the engine, at random
// inputs: what a new operator gets without a line of its own.
#include <map>
#include <set>

#include "nova/support.h"
#include "novaphy/diff/engine_kernels.h"
#include "novaphy/nova/registry.h"

namespace novaphy::testing {
namespace {

std::vector<nova::EngineKernel> all_kernels() {
  std::vector<nova::EngineKernel> kernels = nova::engine_kernels();
  for (nova::EngineKernel& k : diff::engine_kernels()) kernels.push_back(std::move(k));
  return kernels;
}

// Positive values around 1, so that square roots and divisions are smooth; the first 64 sources
// may carry gradients.
Call random_call(const Kernel& kernel, uint32_t seed) {
  Random random(seed);
  constexpr int64_t kRows = 6, kItems = 13;
  Call call{kernel, kRows, {}};
  const nova::ir::Program& p = kernel.traced();
  for (const nova::SourceSpec& s : kernel.sources()) {
    const int64_t rows = s.access == Access::Uniform  ? 1
                         : s.access == Access::CsrRow ? kItems
                                                      : kRows;
    if (s.dtype == DType::F32) {
      call.inputs.push_back(random.leaf({rows, s.width}, 0.25f, 2.0f));
    } else {
      std::vector<int32_t> values(static_cast<size_t>(rows * s.width));
      for (int32_t& v : values) v = random.below(static_cast<int32_t>(kRows));
      call.inputs.push_back(table(values, s.width));
    }
  }
  bool csr = false;
  int32_t params = p.param_count;
  for (const nova::ir::Loop& l : p.loops) {
    csr = csr || l.kind == nova::ir::LoopKind::Csr;
    if (l.kind == nova::ir::LoopKind::Fixed) --params;  // the last one: the extent
  }
  if (csr) {
    std::vector<int32_t> rows(kItems);
    for (int32_t& v : rows) v = random.below(static_cast<int32_t>(kRows) + 1) - 1;
    call.csr = nova::make_incidence(table(rows).operand(), kRows);
  }
  call.extent = 4;
  std::vector<bool> is_int(static_cast<size_t>(params), false);
  for (const nova::ir::Instr& in : p.instrs)
    if (in.op == nova::ir::Op::PARAM_I && in.a < params) is_int[static_cast<size_t>(in.a)] = true;
  for (const bool integer : is_int)
    call.params.push_back(integer ? Param(int32_t{1}) : Param(random.uniform(0.25f, 1.0f)));
  return call;
}

bool finite(const std::vector<Tensor>& tensors) {
  for (const Tensor& t : tensors)
    for (const float x : t.to_host())
      if (!std::isfinite(x)) return false;
  return true;
}

TEST(EngineKernels, KeepTheDotProductIdentity) {
  std::set<std::string> names;
  for (const nova::EngineKernel& k : all_kernels()) {
    if (k.gradients.empty()) continue;  // part of a backward or of an optimiser
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

// The gradients of those inputs that carry one, given weights of some of the outputs.
std::map<size_t, std::vector<float>> gradients(const Call& call, const std::vector<bool>& carries,
                                               uint32_t seeded, nova::KeepGradients keep) {
  for (size_t s = 0; s < call.inputs.size(); ++s) {
    if (call.inputs[s].dtype() != DType::F32) continue;
    call.inputs[s].zero_grad();
    call.inputs[s].set_requires_grad(carries[s]);
  }
  Tape tape(keep);
  const TapeScope scope(tape);
  const std::vector<Tensor> out = call();
  Tensor loss;
  Random random(7);
  for (size_t o = 0; o < out.size(); ++o) {
    const Tensor weights = tensor(random.values(out[o].size()), out[o].shape());
    if ((seeded >> o & 1) == 0) continue;
    const Tensor part = nova::dot(out[o], weights);
    loss = loss.defined() ? nova::add(loss, part) : part;
  }
  tape.backward(loss);
  std::map<size_t, std::vector<float>> found;
  for (size_t s = 0; s < call.inputs.size(); ++s)
    if (call.inputs[s].dtype() == DType::F32 && carries[s])
      found[s] = call.inputs[s].grad().to_host();
  return found;
}

// A part of what is built ahead takes the adjoint of the whole. Zeros may differ in their signs.
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
