// The steps of SolverSemiImplicit on devices other than the CPU.
#pragma once

#include <memory>

#include "novaphy/core/sim/solver_base.h"
#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"

namespace novaphy::detail {

// Returns a solver for a model on another device than the CPU; null for a model on the CPU. The
// options must be checked and complete. ErrorKind::NotImplemented: the library was built without
// the kernels (NOVAPHY_WITH_NOVA=OFF), or the kernels do not support the options.
std::unique_ptr<SolverBase> make_device_steps(const std::shared_ptr<const Model>& model,
                                              const SemiImplicitOptions& options);

}  // namespace novaphy::detail
