// Internal: what the files of the tensor functions (ops.cpp, ops_*.cpp) share, and kernels that
// others launch into memory of their own.
#pragma once

#include "novaphy/nova/kernel.h"
#include "novaphy/nova/tape.h"

namespace nova::detail {

// out = x limited to [param 0, param 1], value by value; NaN stays NaN.
const Kernel& clamp_kernel();
// Limits that clamp takes: ErrorKind::Value unless lower <= upper (so also for NaN).
void check_limits(const char* call, float lower, float upper);

// A shape seen from one dimension: {outer, count, inner}.
struct Along {
  size_t axis = 0;
  int64_t outer = 1, count = 1, inner = 1;
};
Along along(const char* call, const Shape& shape, int64_t axis);  // see sum
// A size as a launch parameter: ErrorKind::Value beyond 32 bits.
Param int_param(const char* call, int64_t value);
using Gradients = std::span<const Tensor>;
using InputGradients = std::span<const InputGradient>;
// Tangents of the inputs (undefined: zero) to that of the output.
using TangentFn = std::function<Tensor(std::span<const Tensor>)>;
// Records out = f(inputs), which was computed, if a tape is active. `reads`: what vjp and tangent
// read the values of.
void record(const char* name, std::vector<Tensor> inputs, const Tensor& out,
            decltype(CustomOp::vjp) vjp, TangentFn tangent, std::vector<Tensor> reads = {});

}  // namespace nova::detail
