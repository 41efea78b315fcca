#include "step_kernel_set.h"

namespace novaphy::vbd {

int lanes_on(Device device) { return device.is_cpu() ? sweep_level().lanes : kVbdLanes; }

const Kernels& kernels() {
  static const auto& all = *new Kernels;
  return all;
}

}  // namespace novaphy::vbd
