// The set of the kernels of VBD. On the CPU the kernels over groups use all SIMD lanes of the
// instruction set (sweep.h). Their results have the same bits as on a device.
#pragma once

#include <cstddef>

#include "novaphy/core/device_kernel.h"
#include "sweep.h"
#include "vbd_adjoint_kernels.h"
#include "vbd_coarse_kernels.h"
#include "vbd_gradient_kernels.h"
#include "vbd_kernels.h"
#include "vbd_tangent_kernels.h"

namespace novaphy::detail {
const char* vbd_kernels_source();
const char* vbd_adjoint_kernels_source();
const char* vbd_coarse_kernels_source();
const char* vbd_gradient_kernels_source();
const char* vbd_tangent_kernels_source();
}  // namespace novaphy::detail

namespace novaphy::vbd {

// Returns the number of lanes of a group on a device.
int lanes_on(Device device);

// Runs a kernel for the CPU's instruction set. The arguments of these kernels begin with
// VbdSweepArguments.
template <GroupKernel* SweepLevel::*of>
void run_level(const uint64_t* words, int64_t n, int64_t begin, int64_t end) {
  const auto& sweep = novaphy::detail::arguments_of<VbdSweepArguments>(words);
  (sweep_level_of(sweep.lanes).*of)(words, n, begin, end);
}
static_assert(offsetof(VbdAdjointArguments, sweep) == 0 &&
              offsetof(VbdTangentArguments, sweep) == 0 &&
              offsetof(VbdCoarseArguments, sweep) == 0);
template <class A>
constexpr RowKernel<A> with_rows(RowKernel<A> kernel, GroupKernel* rows) {
  kernel.rows = rows;
  return kernel;
}
// A kernel with its function for the CPU. The object is a constant, because recordings refer to it.
template <const auto& kernel, GroupKernel* SweepLevel::*of>
inline constexpr auto kLanes = with_rows(kernel, run_level<of>);

struct Kernels {
#define NOVAPHY_KERNEL_OF(module, name)                    \
  Kernel<decltype(vbd_##name)::Arguments> name{vbd_##name, \
                                               novaphy::detail::module##_kernels_source};
#define NOVAPHY_LEVEL_KERNEL_OF(module, name, of)                                   \
  Kernel<decltype(vbd_##name)::Arguments> name{kLanes<vbd_##name, &SweepLevel::of>, \
                                               novaphy::detail::module##_kernels_source};
  NOVAPHY_KERNEL_OF(vbd, predict)
  NOVAPHY_KERNEL_OF(vbd, target)
  NOVAPHY_KERNEL_OF(vbd, activation)
  NOVAPHY_KERNEL_OF(vbd, numbers)
  NOVAPHY_KERNEL_OF(vbd, material)
  NOVAPHY_KERNEL_OF(vbd, contact)
  NOVAPHY_LEVEL_KERNEL_OF(vbd, prepare, prepare)
  NOVAPHY_LEVEL_KERNEL_OF(vbd, move, move)
  NOVAPHY_LEVEL_KERNEL_OF(vbd, move_guarded, move_guarded)
  NOVAPHY_KERNEL_OF(vbd, move_by_blocks)
  NOVAPHY_KERNEL_OF(vbd, commit)
  NOVAPHY_KERNEL_OF(vbd, accelerate)
  NOVAPHY_KERNEL_OF(vbd, finish)
  NOVAPHY_LEVEL_KERNEL_OF(vbd, residual, residual)

  // On devices a color in reverse needs two kernels: the first solves for the multipliers, the
  // second handles the slots. On the CPU the second kernel does all the work of its groups, and
  // stores no own terms.
  NOVAPHY_KERNEL_OF(vbd_adjoint, adjoint_solve)
  NOVAPHY_KERNEL_OF(vbd_adjoint, adjoint_solve_by_blocks)
  NOVAPHY_LEVEL_KERNEL_OF(vbd_adjoint, adjoint_slots, adjoint)
  NOVAPHY_LEVEL_KERNEL_OF(vbd_adjoint, adjoint_solution, adjoint)
  NOVAPHY_LEVEL_KERNEL_OF(vbd_adjoint, adjoint_outer, adjoint_outer)
  NOVAPHY_LEVEL_KERNEL_OF(vbd_adjoint, adjoint_stiffness, adjoint_stiffness)
  NOVAPHY_LEVEL_KERNEL_OF(vbd_adjoint, tangent_stiffness, tangent_stiffness)
  NOVAPHY_LEVEL_KERNEL_OF(vbd_adjoint, adjoint_start, adjoint_start)

  NOVAPHY_KERNEL_OF(vbd_gradient, clear)
  NOVAPHY_KERNEL_OF(vbd_gradient, keep)
  NOVAPHY_KERNEL_OF(vbd_gradient, adjoint_begin)
  NOVAPHY_KERNEL_OF(vbd_gradient, adjoint_end)
  NOVAPHY_KERNEL_OF(vbd_gradient, receive)
  NOVAPHY_KERNEL_OF(vbd_gradient, particle_gradient)
  NOVAPHY_KERNEL_OF(vbd_gradient, target_gradient)
  NOVAPHY_KERNEL_OF(vbd_gradient, gravity_gradient)
  NOVAPHY_KERNEL_OF(vbd_gradient, element_gradient)
  NOVAPHY_KERNEL_OF(vbd_gradient, radius_gradient)
  NOVAPHY_KERNEL_OF(vbd_gradient, contact_shape)
  NOVAPHY_KERNEL_OF(vbd_gradient, shape_gradient)

  NOVAPHY_LEVEL_KERNEL_OF(vbd_tangent, tangent, tangent)
  NOVAPHY_LEVEL_KERNEL_OF(vbd_tangent, tangent_start, tangent_start)
  NOVAPHY_KERNEL_OF(vbd_tangent, tangent_move)

  NOVAPHY_LEVEL_KERNEL_OF(vbd_coarse, coarse_rows, coarse_rows)
  NOVAPHY_LEVEL_KERNEL_OF(vbd_coarse, coarse_force, coarse_force)
  NOVAPHY_LEVEL_KERNEL_OF(vbd_coarse, coarse_outer, coarse_outer)
  NOVAPHY_KERNEL_OF(vbd_coarse, coarse_matrix)
  NOVAPHY_KERNEL_OF(vbd_coarse, coarse_factor)
  NOVAPHY_KERNEL_OF(vbd_coarse, coarse_load)
  NOVAPHY_KERNEL_OF(vbd_coarse, coarse_solve)
  NOVAPHY_KERNEL_OF(vbd_coarse, coarse_test)
  NOVAPHY_KERNEL_OF(vbd_coarse, coarse_try)
  NOVAPHY_KERNEL_OF(vbd_coarse, coarse_take)
  NOVAPHY_KERNEL_OF(vbd_coarse, coarse_fields)
  NOVAPHY_KERNEL_OF(vbd_coarse, coarse_balance)
  NOVAPHY_KERNEL_OF(vbd_coarse, coarse_shift)
#undef NOVAPHY_KERNEL_OF
#undef NOVAPHY_LEVEL_KERNEL_OF
};
// Returns the kernels. They are never destroyed, because recordings refer to them.
const Kernels& kernels();

}  // namespace novaphy::vbd
