// Launch arguments that must not compile. tests/core/CMakeLists.txt compiles this file once for
// each value of MISTAKE, and looks for the message of that mistake. Without MISTAKE the file
// compiles.
#include "novaphy/core/device_kernel.h"

namespace novaphy::testing {

struct ScaleArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<float> x; WritesRow<float> y; Number<float> factor;)
};
NOVAPHY_ROW_KERNEL(scale, ScaleArguments) {
#if MISTAKE == 1
  a.x[row] = a.y[row];
#endif
  a.y[row] = a.factor.value * a.x[row];
}

void launch(const Kernel<ScaleArguments>& kernel, const DeviceArray<float>& x,
            const DeviceArray<float>& y, [[maybe_unused]] const DeviceArray<int32_t>& i) {
#if MISTAKE == 2
  run(kernel, 4, {.x = x, .factor = 2.0f});
#elif MISTAKE == 3
  run(kernel, 4, {.x = i, .y = y, .factor = 2.0f});
#elif MISTAKE == 4
  run(kernel, 4, {.x = x, .y = y, .factor = 2});
#elif MISTAKE == 5
  run(kernel, 4, {.x = DeviceArray<float>(4), .y = y, .factor = 2.0f});
#else
  run(kernel, 4, {.x = x, .y = y, .factor = 2.0f});
#endif
}

}  // namespace novaphy::testing
