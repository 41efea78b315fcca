// The kernels of a step of VBD. On the CPU the sweeps run with all lanes of its instruction set
// (sweep.h), which have the bits of a device's threads.
#pragma once

#include "novaphy/core/device_kernel.h"
#include "vbd_gradient_kernels.h"
#include "vbd_kernels.h"

namespace novaphy::vbd {

struct StepKernels {
  Kernel<VbdPredictArguments> predict;
  Kernel<VbdSweepArguments> prepare, move, move_guarded, move_team, residual;
  Kernel<VbdCommitArguments> commit;
  Kernel<VbdAccelerateArguments> accelerate;
  Kernel<VbdKeepArguments> keep;
  Kernel<VbdFinishArguments> finish;
  Kernel<VbdClearArguments> clear;
};
// Never destroyed: recordings refer to them.
const StepKernels& step_kernels();

}  // namespace novaphy::vbd
