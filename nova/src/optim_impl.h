// Internal: what the optimizer functions and classes share.
#pragma once

#include <span>

#include "checks.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/optim.h"
#include "novaphy/nova/trace.h"

namespace nova::detail {

// ErrorKind::Value unless finite and >= 0.
void check_rate(const Argument& argument, float value);
// ErrorKind::Value unless the parameter has a gradient.
void check_has_grad(const Tensor& param, const Argument& argument);
// "params" of a call: not empty, float32, on one device, none twice or overlapping.
void check_params(std::span<const Tensor> params, const char* call);
void check_grads(std::span<const Tensor> params, const char* call);

// ErrorKind::Runtime unless all gradients are finite; looks at them on the host.
void check_finite_grads(std::span<const Tensor> params, const char* call);
// total = the sum of f over the values of all gradients, as one row sum that goes on from one
// parameter to the next.
void sum_over_grads(std::span<const Tensor> params, const Kernel& f, const Operand& total);

// The gradient, value by value; it is zero where no backward has filled it.
Operand grad_operand(const Tensor& param);

// The number of the update that runs now, from the number of those before (a float32 that holds an
// integer, so that a kernel can write it). What is no count (negative, NaN) counts as 0. It stays
// at 2^24 - 1, the last step that float32 can make; bias corrections are long 1 by then.
inline constexpr int kCountBits = 24;
Int next_count(const Real& t);

// What a step leaves: `unfit` is 0, or a gradient is not finite.
inline Real if_fit(const Real& unfit, const Real& next, const Real& now) {
  return select(unfit == Real(0.0f), next, now);
}

}  // namespace nova::detail
