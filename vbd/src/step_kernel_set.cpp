#include "step_kernel_set.h"

namespace novaphy::vbd {

const Kernels& kernels() {
  static const auto& all = *new Kernels;
  return all;
}

}  // namespace novaphy::vbd
