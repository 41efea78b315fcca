// Internal: functions that all optimizers share.
#pragma once

#include <span>

#include "checks.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/optim.h"
#include "novaphy/nova/trace.h"

namespace nova::detail {

// Throws ErrorKind::Value unless the value is finite and >= 0.
void check_rate(const Argument& argument, float value);
// Throws ErrorKind::Value unless the parameter has a gradient.
void check_has_grad(const Tensor& param, const Argument& argument);
// Checks the parameters of a call: at least one, float32, on one device, without overlap.
void check_params(std::span<const Tensor> params, const char* call);
void check_grads(std::span<const Tensor> params, const char* call);

// Throws ErrorKind::Runtime unless all gradients are finite. Reads them on the host.
void check_finite_grads(std::span<const Tensor> params, const char* call);
// Sets `total` to the sum of f over the values of all gradients. One row sum continues from
// parameter to parameter.
void sum_over_grads(std::span<const Tensor> params, const Kernel& f, const Operand& total);

// Returns the gradient as single values. A gradient that no backward pass has filled is zero.
Operand grad_operand(const Tensor& param);

// Returns the number of the current update from the number of earlier updates, a float32 with an
// integer value. A value that is negative or NaN counts as 0. The number stops at 2^24 - 1, the
// largest count in float32. The bias corrections are 1 long before.
inline constexpr int kCountBits = 24;
Int next_count(const Real& t);

// Returns `next` if `unfit` is 0, else `now`. unfit is NaN if a gradient is not finite, and the
// step then changes nothing.
inline Real if_fit(const Real& unfit, const Real& next, const Real& now) {
  return select(unfit == Real(0.0f), next, now);
}

}  // namespace nova::detail
