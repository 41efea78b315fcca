// Internal: running the adjoint of one kernel call.
#pragma once

#include "kernel_impl.h"
#include "novaphy/nova/op_list.h"

namespace nova::detail {

struct AdjointCall {
  int64_t dim = 0;
  AdjointKey asked = {};  // what is wanted: all or a part of what the plan has
  std::span<const Operand* const> inputs = {};
  std::span<const std::shared_ptr<Range>* const> input_gradients = {};   // those wanted
  std::span<const std::shared_ptr<Range>* const> output_gradients = {};  // null: zeros
  int64_t output_gradient_rows = 0;
  std::span<const Param> params = {};
  const Incidence* csr = nullptr;
  int32_t extent = 0;
  const Operand* active = nullptr;
  ScratchMemory* scratch = nullptr;  // for a call that no capture records
};

// Runs (or captures) the stages and row-sums of a plan. Stores into or adds to the gradients as the
// call asks.
void run_adjoint(KernelImpl& kernel, const CompiledPlan& plan, const AdjointCall& call);

// Memory for one operation; a capture keeps it.
Operand temporary(int64_t rows, int32_t width, const novaphy::Device& device);

}  // namespace nova::detail
