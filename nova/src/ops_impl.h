// Internal: kernels of ops.cpp that others launch into memory of their own.
#pragma once

#include "novaphy/nova/kernel.h"

namespace nova::detail {

// out = x limited to [param 0, param 1], value by value; NaN stays NaN.
const Kernel& clamp_kernel();
// Limits that clamp takes: ErrorKind::Value unless lower <= upper (so also for NaN).
void check_limits(const char* call, float lower, float upper);

}  // namespace nova::detail
