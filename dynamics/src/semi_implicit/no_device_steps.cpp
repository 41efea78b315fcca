#include "device_steps.h"
#include "novaphy/core/error.h"

namespace novaphy {

std::unique_ptr<SolverBase> detail::make_device_steps(const std::shared_ptr<const Model>& model,
                                                      const SemiImplicitOptions&) {
  require(model->device().is_cpu(), ErrorKind::NotImplemented,
          "SolverSemiImplicit: model: expected one on the cpu, got one on ", model->device().str(),
          ", whose kernels this build leaves out: configure with NOVAPHY_WITH_NOVA=ON");
  return nullptr;
}

}  // namespace novaphy
