// Hand-written kernels for tests of the door.
#pragma once

#include "novaphy/core/row_kernel.h"

namespace novaphy::testing {

struct ScaleArguments {
  const float* x;
  float* y;
  FloatWord factor;
};
// y = factor x, row by row.
NOVAPHY_ROW_KERNEL(test_scale, 3, ScaleArguments) { a.y[row] = a.factor.value * a.x[row]; }

struct ReverseArguments {
  const float* x;
  float* y;
};
// y is x from its end to its begin.
NOVAPHY_ROW_KERNEL(test_reverse, 2, ReverseArguments) { a.y[row] = a.x[n - 1 - row]; }

}  // namespace novaphy::testing
