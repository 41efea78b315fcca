// Internal: functions that ops.cpp and ops_*.cpp share, and kernels that other files launch into
// their own memory.
#pragma once

#include "novaphy/nova/kernel.h"
#include "novaphy/nova/tape.h"

namespace nova::detail {

// Returns the kernel that limits x to [param 0, param 1] value by value. NaN stays NaN.
const Kernel& clamp_kernel();
// Throws ErrorKind::Value unless lower <= upper. NaN throws too.
void check_limits(const char* call, float lower, float upper);

// A shape as {outer, count, inner} around one dimension `axis`, which has `count` entries.
struct Along {
  size_t axis = 0;
  int64_t outer = 1, count = 1, inner = 1;
};
Along along(const char* call, const Shape& shape, int64_t axis);  // errors as for sum
// Returns a size as a launch parameter. ErrorKind::Value: more than 32 bits.
Param int_param(const char* call, int64_t value);
using Gradients = std::span<const Tensor>;
using InputGradients = std::span<const InputGradient>;
// Computes the tangent of the output from those of the inputs. An undefined tangent is zero.
using TangentFn = std::function<Tensor(std::span<const Tensor>)>;
// Records out = f(inputs), already computed by `forward`, if a tape is active. `reads`: tensors
// whose values vjp and tangent read.
void record(const char* name, std::vector<Tensor> inputs, const Tensor& out,
            std::function<void()> forward, decltype(CustomOp::vjp) vjp, TangentFn tangent,
            std::vector<Tensor> reads = {});

}  // namespace nova::detail
