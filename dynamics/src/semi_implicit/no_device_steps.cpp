#include "device_steps.h"
#include "novaphy/core/error.h"

namespace novaphy {

std::unique_ptr<SolverBase> detail::make_device_steps(const std::shared_ptr<const Model>& model,
                                                      const SemiImplicitOptions&) {
  require_cpu(model->device(), "SolverSemiImplicit: model: a build with NOVAPHY_WITH_NOVA=OFF");
  return nullptr;
}

}  // namespace novaphy
