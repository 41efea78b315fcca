#include "novaphy/diff/engine_kernels.h"

#include "novaphy/dynamics/diff_operators.h"

namespace novaphy::diff {

std::vector<nova::EngineKernel> engine_kernels() {
  std::vector<nova::EngineKernel> list = operator_kernels();
  detail::add_loss_kernels(list);
  detail::add_push_box_kernels(list);
  detail::add_rigid_loss_kernels(list);
  return list;
}

}  // namespace novaphy::diff
