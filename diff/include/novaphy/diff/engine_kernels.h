// The list of the kernels of the engine's operators and losses, with the gradients that the build
// compiles ahead of time; see <novaphy/nova/registry.h>.
#pragma once

#include <vector>

#include "novaphy/diff/export.h"
#include "novaphy/nova/registry.h"

namespace novaphy::diff {

NOVAPHY_DIFF_API std::vector<nova::EngineKernel> engine_kernels();

namespace detail {
void add_loss_kernels(std::vector<nova::EngineKernel>& list);        // losses.cpp
void add_push_box_kernels(std::vector<nova::EngineKernel>& list);    // push_box.cpp
void add_rigid_loss_kernels(std::vector<nova::EngineKernel>& list);  // rigid_losses.cpp
}  // namespace detail

}  // namespace novaphy::diff
