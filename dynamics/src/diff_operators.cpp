#include "novaphy/dynamics/diff_operators.h"

namespace novaphy::diff {

std::vector<nova::EngineKernel> operator_kernels() {
  std::vector<nova::EngineKernel> list;
  detail::add_contact_kernels(list);
  detail::add_derived_kernels(list);
  detail::add_element_kernels(list);
  detail::add_particle_kernels(list);
  detail::add_rigid_kernels(list);
  detail::add_solver_kernels(list);
  return list;
}

std::vector<nova::AdjointMask> detail::state_gradients(const nova::Kernel& kernel,
                                                       const std::vector<std::string>& state) {
  std::vector<std::string> all;
  for (const nova::OutputSpec& o : kernel.outputs()) all.push_back(o.name);
  std::vector<nova::AdjointMask> masks = {nova::gradient_mask(kernel, state, {}, all)};
  if (all.size() > 1)
    for (const std::string& name : all)
      masks.push_back(nova::gradient_mask(kernel, state, {}, {name}));
  return masks;
}

std::vector<nova::AdjointMask> detail::rollout_gradients(
    const nova::Kernel& kernel, const std::vector<std::string>& state,
    const std::vector<std::string>& others, const std::vector<std::string>& materials) {
  using Names = std::vector<std::string>;
  const auto join = [](Names a, const Names& b) {
    a.insert(a.end(), b.begin(), b.end());
    return a;
  };
  std::vector<Names> states, extras = {{}, materials};
  for (size_t bits = 0; bits < size_t{1} << state.size(); ++bits) {
    Names some;
    for (size_t k = 0; k < state.size(); ++k)
      if (bits >> k & 1) some.push_back(state[k]);
    states.push_back(std::move(some));
  }
  for (const std::string& name : others) extras.push_back({name});
  Names all;
  std::vector<Names> seeds;  // all outputs, and each of them: a loss reads the last state
  for (const nova::OutputSpec& o : kernel.outputs()) {
    all.push_back(o.name);
    if (kernel.outputs().size() > 1) seeds.push_back({o.name});
  }
  std::vector<nova::AdjointMask> masks;
  const auto want = [&](const Names& wrt, const Names& accumulate, const Names& seeded) {
    masks.push_back(nova::gradient_mask(kernel, wrt, accumulate, seeded));
  };
  for (const Names& s : states)
    for (const Names& extra : extras) {
      const Names wrt = join(s, extra);
      // Whoever wants the gradient of a model's array lets the whole state carry it, but for the
      // first step.
      if (wrt.empty() || (!extra.empty() && s.size() == 1)) continue;
      want(wrt, {}, all);
      if (!extra.empty()) want(wrt, extra, all);
      if (!s.empty() && extra.empty()) want(wrt, s, all);
      // A shorter list where a loss reads one output: of the whole state.
      if (s.size() == state.size() || extra.empty())
        for (const Names& seed : seeds) want(wrt, {}, seed);
    }
  return masks;
}

}  // namespace novaphy::diff
