#include "novaphy/nova/registry.h"

#include <algorithm>
#include <map>

#include "engine_kernels.h"
#include "kernel_impl.h"
#include "novaphy/core/error.h"

namespace nova {

std::vector<EngineKernel> engine_kernels() {
  std::vector<EngineKernel> list;
  detail::add_op_kernels(list);
  detail::add_sum_kernels(list);
  detail::add_row_kernels(list);
  detail::add_matmul_kernels(list);
  detail::add_vector_kernels(list);
  detail::add_network_kernels(list);
  detail::add_optim_kernels(list);
  detail::add_tape_kernels(list);
  detail::add_tensor_kernels(list);
  return list;
}

std::vector<ir::Program> programs_of(const std::vector<EngineKernel>& kernels) {
  std::map<uint64_t, ir::Program> programs;
  // Equal Programs may have several names. The alphabetically first name is taken, so that the
  // choice does not depend on the order of the list.
  const auto add = [&](const ir::Program& p) {
    const auto [entry, fresh] = programs.try_emplace(ir::hash(p), p);
    if (!fresh && p.name < entry->second.name) entry->second = p;
  };
  for (const EngineKernel& k : kernels) {
    add(k.kernel.program());
    for (const AdjointMask& mask : k.gradients) {
      const AdjointPlan& plan = k.kernel.adjoint(mask);
      for (const auto* stages : {&plan.rows, &plan.items})
        for (const AdjointStage& stage : *stages) add(stage.program);
    }
  }
  std::vector<ir::Program> list;
  for (auto& [hash, program] : programs) list.push_back(std::move(program));
  return list;
}

Kernel with_gradients(Kernel kernel, std::vector<AdjointMask> gradients) {
  detail::KernelImpl& impl = *kernel.impl();
  impl.gradient_keys.clear();
  for (const AdjointMask& mask : gradients) impl.gradient_keys.push_back(detail::key_of(mask));
  impl.gradients = std::move(gradients);
  return kernel;
}

AdjointMask gradient_mask(const Kernel& kernel, const std::vector<std::string>& wrt,
                          const std::vector<std::string>& accumulate,
                          const std::vector<std::string>& seeded) {
  const auto has = [](const std::vector<std::string>& names, const std::string& name) {
    return std::find(names.begin(), names.end(), name) != names.end();
  };
  AdjointMask mask;
  size_t found = 0;
  for (const SourceSpec& s : kernel.sources()) {
    mask.wrt.push_back(has(wrt, s.name));
    mask.accumulate.push_back(has(accumulate, s.name));
    found += (mask.wrt.back() ? 1u : 0u) + (mask.accumulate.back() ? 1u : 0u);
  }
  for (const OutputSpec& o : kernel.outputs()) {
    mask.seeded.push_back(has(seeded, o.name));
    found += mask.seeded.back() ? 1u : 0u;
  }
  novaphy::require(found == wrt.size() + accumulate.size() + seeded.size(), ErrorKind::Value,
                   "gradient_mask: kernel '", kernel.name(), "' lacks one of the names");
  return mask;
}

std::vector<AdjointMask> one_gradient_set(const Kernel& kernel) {
  AdjointMask mask;
  for (const SourceSpec& s : kernel.sources()) mask.wrt.push_back(s.dtype == DType::F32);
  mask.accumulate.assign(mask.wrt.size(), false);
  mask.seeded.assign(kernel.outputs().size(), true);
  mask.gated = true;
  return {mask};
}

std::vector<AdjointMask> gradient_sets(const Kernel& kernel,
                                       const std::vector<std::string>& state) {
  std::vector<std::string> outputs;
  for (const OutputSpec& o : kernel.outputs()) outputs.push_back(o.name);
  return {gradient_mask(kernel, state, {}, outputs), one_gradient_set(kernel)[0]};
}

Kernel with_one_gradient_set(const Kernel& kernel) {
  return with_gradients(kernel, one_gradient_set(kernel));
}
Kernel with_gradient_sets(const Kernel& kernel, const std::vector<std::string>& state) {
  return with_gradients(kernel, gradient_sets(kernel, state));
}

}  // namespace nova
