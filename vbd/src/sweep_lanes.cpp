// The kernels of a sweep, compiled for one instruction set. They move LANES particles of a color at
// a time.
#include "lanes.h"

namespace novaphy::vbd::NOVAPHY_LEVEL {

template <void (*body)(const LaneGroup<Lanes>&)>
constexpr GroupKernel* kOf = over_groups<VbdSweepArguments, of_sweep<body>>;

extern const SweepLevel kLevel;
const SweepLevel kLevel = {.name = NOVAPHY_LEVEL_NAME,
                           .lanes = LANES,
                           .prepare = kOf<vbd::prepare<Lanes>>,
                           .move = kOf<vbd::move<false, Lanes>>,
                           .move_guarded = kOf<vbd::move<true, Lanes>>,
                           .residual = kOf<vbd::residual<Lanes>>,
                           .write_block = kOf<vbd::write_block<Lanes>>,
                           .adjoint = adjoint,
                           .adjoint_outer = adjoint_outer,
                           .adjoint_stiffness = adjoint_stiffness,
                           .adjoint_start = adjoint_start,
                           .tangent = tangent,
                           .tangent_stiffness = tangent_stiffness,
                           .tangent_start = tangent_start,
                           .coarse_rows = coarse_rows,
                           .coarse_force = coarse_force,
                           .coarse_outer = coarse_outer};

}  // namespace novaphy::vbd::NOVAPHY_LEVEL
