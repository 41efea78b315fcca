// Who steps models that live on another device than the CPU. This library knows no kernels;
// novaphy::diff does, and registers itself here when it is loaded.
#pragma once

#include <memory>

#include "novaphy/core/sim/solver_base.h"
#include "novaphy/dynamics/export.h"

namespace novaphy {

// Makes a solver of the same steps as SolverSemiImplicit's, to the bit.
using DeviceSolverFactory = std::unique_ptr<SolverBase> (*)(std::shared_ptr<const Model> model);
NOVAPHY_DYNAMICS_API void set_device_solver(DeviceSolverFactory make);

}  // namespace novaphy
