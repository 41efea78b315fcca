// Internal: runs the adjoint of one kernel call.
#pragma once

#include "kernel_impl.h"
#include "novaphy/nova/op_list.h"

namespace nova::detail {

struct AdjointCall {
  int64_t dim = 0;
  AdjointKey wanted = {};  // requested gradients, which may be a part of the plan's
  std::span<const Operand* const> inputs = {};
  // one gradient for each requested source
  std::span<const std::shared_ptr<Range>* const> input_gradients = {};
  // null: the gradient is zero
  std::span<const std::shared_ptr<Range>* const> output_gradients = {};
  int64_t output_gradient_rows = 0;
  std::span<const Param> params = {};
  const Incidence* csr = nullptr;
  int32_t extent = 0;
  const Operand* active = nullptr;
  ScratchMemory* scratch = nullptr;  // for a call outside of captures
};

// Runs or captures the stages and row sums of a plan. Each gradient is stored or added to, as the
// call requests.
void run_adjoint(KernelImpl& kernel, const CompiledPlan& plan, const AdjointCall& call);

// Allocates memory for one operation; a capture keeps it alive.
Operand temporary(int64_t rows, int32_t width, const novaphy::Device& device);

}  // namespace nova::detail
