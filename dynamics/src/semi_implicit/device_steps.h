// The steps of SolverSemiImplicit on other devices than the CPU.
#pragma once

#include <memory>

#include "novaphy/core/sim/solver_base.h"

namespace novaphy::detail {

// Null: the model is on the CPU. ErrorKind::NotImplemented: this library was built without the
// kernels (NOVAPHY_WITH_NOVA=OFF).
std::unique_ptr<SolverBase> make_device_steps(const std::shared_ptr<const Model>& model);

}  // namespace novaphy::detail
