// Calls the engine's kernels with random arguments.
#pragma once

#include <map>
#include <vector>

#include "nova/support.h"
#include "novaphy/diff/engine_kernels.h"
#include "novaphy/nova/registry.h"

namespace novaphy::testing {

inline std::vector<nova::EngineKernel> all_kernels() {
  std::vector<nova::EngineKernel> kernels = nova::engine_kernels();
  for (nova::EngineKernel& k : diff::engine_kernels()) kernels.push_back(std::move(k));
  return kernels;
}

// Positive values around 1, so that square roots and divisions are smooth; the first 64 sources
// may carry gradients.
inline Call random_call(const Kernel& kernel, uint32_t seed) {
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
  bool csr = false, fixed = false;
  int32_t params = p.param_count;
  for (const nova::ir::Loop& l : p.loops) {
    csr = csr || l.kind == nova::ir::LoopKind::Csr;
    fixed = fixed || l.kind == nova::ir::LoopKind::Fixed;
  }
  if (fixed) {
    call.extent = 4;
    --params;  // the last one: the extent
  }
  if (csr) {
    std::vector<int32_t> rows(kItems);
    for (int32_t& v : rows) v = random.below(static_cast<int32_t>(kRows) + 1) - 1;
    call.csr = nova::make_incidence(table(rows).operand(), kRows);
  }
  std::vector<bool> is_int(static_cast<size_t>(params), false);
  for (const nova::ir::Instr& in : p.instrs)
    if (in.op == nova::ir::Op::PARAM_I && in.a < params) is_int[static_cast<size_t>(in.a)] = true;
  for (const bool integer : is_int)
    call.params.push_back(integer ? Param(int32_t{1}) : Param(random.uniform(0.25f, 1.0f)));
  return call;
}

// The gradients of those inputs that carry one, given weights of some of the outputs: stored the
// first time, then added to.
inline std::map<size_t, std::vector<float>> gradients(const Call& call,
                                                      const std::vector<bool>& carries,
                                                      uint32_t seeded, nova::KeepGradients keep,
                                                      uint32_t times = 2) {
  for (size_t s = 0; s < call.inputs.size(); ++s) {
    if (call.inputs[s].dtype() != DType::F32) continue;
    call.inputs[s].zero_grad();
    call.inputs[s].set_requires_grad(carries[s]);
  }
  for (uint32_t time = 0; time < times; ++time) {
    Tape tape(keep);
    const TapeScope scope(tape);
    const std::vector<Tensor> out = call();
    Tensor loss;
    Random random(7 + time);
    for (size_t o = 0; o < out.size(); ++o) {
      const Tensor weights = tensor(random.values(out[o].size()), out[o].shape());
      if ((seeded >> o & 1) == 0) continue;
      const Tensor part = nova::dot(out[o], weights);
      loss = loss.defined() ? nova::add(loss, part) : part;
    }
    tape.backward(loss);
  }
  std::map<size_t, std::vector<float>> found;
  for (size_t s = 0; s < call.inputs.size(); ++s)
    if (call.inputs[s].dtype() == DType::F32 && carries[s])
      found[s] = call.inputs[s].grad().to_host();
  return found;
}

}  // namespace novaphy::testing
