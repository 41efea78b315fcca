// The steps of SolverSemiImplicit on other devices than the CPU.
#pragma once

#include <memory>

#include "novaphy/core/sim/solver_base.h"
#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"

namespace novaphy::detail {

// Null: the model is on the CPU. The options are checked and complete. ErrorKind::NotImplemented:
// this library was built without the kernels (NOVAPHY_WITH_NOVA=OFF), or what they do not cover.
std::unique_ptr<SolverBase> make_device_steps(const std::shared_ptr<const Model>& model,
                                              const SemiImplicitOptions& options);

}  // namespace novaphy::detail
