// Handwritten kernels for tests of the launch interface.
#pragma once

#include "novaphy/core/row_kernel.h"

namespace novaphy::testing {

struct ScaleArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<float> x; WritesRow<float> y; Number<float> factor;)
};
// y = factor x, row by row.
NOVAPHY_ROW_KERNEL(test_scale, ScaleArguments) { a.y[row] = a.factor.value * a.x[row]; }

struct ScaleConstantArguments {
  NOVAPHY_ARGUMENTS(Detached<ReadsRow<float>> x; WritesRow<float> y; Number<float> factor;)
};
NOVAPHY_ROW_KERNEL(test_scale_constant, ScaleConstantArguments) {
  a.y[row] = a.factor.value * a.x[row];
}

struct ReverseArguments {
  NOVAPHY_ARGUMENTS(Reads<float> x; WritesRow<float> y;)
};
// y is x from its end to its begin.
NOVAPHY_ROW_KERNEL(test_reverse, ReverseArguments) { a.y[row] = a.x[n - 1 - row]; }

}  // namespace novaphy::testing
