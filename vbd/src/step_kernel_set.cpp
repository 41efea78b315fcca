#include "step_kernel_set.h"

#include <cstddef>

#include "sweep.h"

namespace novaphy::detail {
const char* vbd_kernels_text();
const char* vbd_adjoint_kernels_text();
const char* vbd_gradient_kernels_text();
const char* vbd_tangent_kernels_text();
}  // namespace novaphy::detail

namespace novaphy::vbd {
namespace {

// On the CPU a kernel over lanes of groups is that of an instruction set. All of their structs
// begin with the arguments of a sweep.
template <auto kernel_of>
void of_level(const uint64_t* words, int64_t n, int64_t begin, int64_t end) {
  const auto& sweep = novaphy::detail::arguments_of<VbdSweepArguments>(words);
  kernel_of(sweep_level_of(sweep.lanes))(words, n, begin, end);
}
static_assert(offsetof(VbdAdjointArguments, sweep) == 0 &&
              offsetof(VbdTangentArguments, sweep) == 0);

template <class A>
constexpr RowKernel<A> with_lanes(RowKernel<A> kernel, decltype(kernel.rows) rows) {
  kernel.rows = rows;
  return kernel;
}
// Kernels refer to them.
template <const auto& kernel, auto kernel_of>
constexpr auto kLanes = with_lanes(kernel, of_level<kernel_of>);
#define NOVAPHY_LEVEL_KERNEL(kernel, of) \
  kLanes<kernel, [](const SweepLevel& level) { return level.of; }>, text

}  // namespace

int lanes_on(Device device) { return device.is_cpu() ? sweep_level().lanes : kVbdLanes; }

const StepKernels& step_kernels() {
  const DeviceText text = detail::vbd_kernels_text,
                   gradient_text = detail::vbd_gradient_kernels_text;
  static const auto& all =
      *new StepKernels{.predict{vbd_predict, text},
                       .target{vbd_target, text},
                       .activation{vbd_activation, text},
                       .contact{vbd_contact, text},
                       .prepare{NOVAPHY_LEVEL_KERNEL(vbd_prepare, prepare)},
                       .move{NOVAPHY_LEVEL_KERNEL(vbd_move, move)},
                       .move_guarded{NOVAPHY_LEVEL_KERNEL(vbd_move_guarded, move_guarded)},
                       .move_team{vbd_move_team, text},
                       .residual{NOVAPHY_LEVEL_KERNEL(vbd_residual, residual)},
                       .commit{vbd_commit, text},
                       .accelerate{vbd_accelerate, text},
                       .keep{vbd_keep, gradient_text},
                       .finish{vbd_finish, text},
                       .clear{vbd_clear, gradient_text}};
  return all;
}

const AdjointKernels& adjoint_kernels() {
  const DeviceText text = detail::vbd_adjoint_kernels_text;
  static const auto& all =
      *new AdjointKernels{.solve{vbd_adjoint_solve, text},
                          .solve_team{vbd_adjoint_solve_team, text},
                          .slots{{{NOVAPHY_LEVEL_KERNEL(vbd_adjoint_slots, adjoint)},
                                  {NOVAPHY_LEVEL_KERNEL(vbd_adjoint_weights, adjoint)}},
                                 {{NOVAPHY_LEVEL_KERNEL(vbd_adjoint_rest, adjoint)},
                                  {NOVAPHY_LEVEL_KERNEL(vbd_adjoint_rest_weights, adjoint)}}},
                          .start{{NOVAPHY_LEVEL_KERNEL(vbd_adjoint_start, adjoint_start)},
                                 {NOVAPHY_LEVEL_KERNEL(vbd_adjoint_start_weights, adjoint_start)}}};
  return all;
}

const TangentKernels& tangent_kernels() {
  const DeviceText text = detail::vbd_tangent_kernels_text;
  static const auto& all =
      *new TangentKernels{.tangent{NOVAPHY_LEVEL_KERNEL(vbd_tangent, tangent)},
                          .start{NOVAPHY_LEVEL_KERNEL(vbd_tangent_start, tangent_start)},
                          .move{vbd_tangent_move, text}};
  return all;
}

}  // namespace novaphy::vbd
