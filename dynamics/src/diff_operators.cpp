#include "novaphy/dynamics/diff_operators.h"

namespace novaphy::diff {

std::vector<nova::EngineKernel> operator_kernels() {
  std::vector<nova::EngineKernel> list;
  detail::add_body_contact_kernels(list);
  detail::add_contact_kernels(list);
  detail::add_derived_kernels(list);
  detail::add_element_kernels(list);
  detail::add_particle_kernels(list);
  detail::add_rigid_kernels(list);
  detail::add_solver_kernels(list);
  return list;
}

nova::Kernel detail::with_state_gradients(const nova::Kernel& kernel,
                                          const std::vector<std::string>& state) {
  return with_rollout_gradients(kernel, state, {}, {});
}

nova::Kernel detail::with_rollout_gradients(const nova::Kernel& kernel,
                                            const std::vector<std::string>& state,
                                            const std::vector<std::string>& others,
                                            const std::vector<std::string>& materials) {
  using Names = std::vector<std::string>;
  Names all;
  for (const nova::OutputSpec& o : kernel.outputs()) all.push_back(o.name);
  std::vector<nova::AdjointMask> masks;
  const auto want = [&](Names extra, const Names& accumulate) {
    extra.insert(extra.end(), state.begin(), state.end());
    masks.push_back(nova::gradient_mask(kernel, extra, accumulate, all));
  };
  want({}, {});
  if (others.empty() && materials.empty()) return nova::with_gradients(kernel, std::move(masks));
  want({}, state);  // a loss reads the state of every step
  std::vector<Names> extras;
  if (!materials.empty()) extras.push_back(materials);
  for (const std::string& name : others) extras.push_back({name});
  for (const Names& extra : extras)
    for (const Names& accumulate : {Names{}, extra}) want(extra, accumulate);
  return nova::with_gradients(kernel, std::move(masks));
}

}  // namespace novaphy::diff
