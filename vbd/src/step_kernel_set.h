// The kernels of VBD. On the CPU those over groups run with all lanes of its instruction set
// (sweep.h), which have the bits of a device's threads.
#pragma once

#include "novaphy/core/device_kernel.h"
#include "vbd_adjoint_kernels.h"
#include "vbd_gradient_kernels.h"
#include "vbd_kernels.h"
#include "vbd_tangent_kernels.h"

namespace novaphy::vbd {

// Of a group on a device.
int lanes_on(Device device);

struct StepKernels {
  Kernel<VbdPredictArguments> predict;
  Kernel<VbdTargetArguments> target;
  Kernel<VbdActivationArguments> activation;
  Kernel<VbdContactArguments> contact;
  Kernel<VbdSweepArguments> prepare, move, move_guarded, move_team, residual;
  Kernel<VbdCommitArguments> commit;
  Kernel<VbdAccelerateArguments> accelerate;
  Kernel<VbdKeepArguments> keep;
  Kernel<VbdFinishArguments> finish;
  Kernel<VbdClearArguments> clear;
};
// Never destroyed, as all kernels: recordings refer to them.
const StepKernels& step_kernels();

// On devices a colour in reverse is two launches, `solve` or `solve_team` and one of `slots`; on
// the CPU the latter does all for the groups of the launch, and leaves no own terms.
struct AdjointKernels {
  Kernel<VbdAdjointArguments> solve, solve_team;
  Kernel<VbdAdjointArguments> slots[2][2];  // at a solution; also by the weights of slots
  Kernel<VbdAdjointArguments> start[2];     // also by the weights of slots
};
const AdjointKernels& adjoint_kernels();

struct TangentKernels {
  Kernel<VbdTangentArguments> tangent, start;
  Kernel<VbdTangentMoveArguments> move;
};
const TangentKernels& tangent_kernels();

}  // namespace novaphy::vbd
