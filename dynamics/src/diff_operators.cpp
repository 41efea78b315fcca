#include "novaphy/dynamics/diff_operators.h"

namespace novaphy::diff {

std::vector<nova::EngineKernel> operator_kernels() {
  std::vector<nova::EngineKernel> list;
  detail::add_body_contact_kernels(list);
  detail::add_contact_kernels(list);
  detail::add_derived_kernels(list);
  detail::add_element_kernels(list);
  detail::add_particle_kernels(list);
  detail::add_rigid_kernels(list);
  detail::add_solver_kernels(list);
  return list;
}

}  // namespace novaphy::diff
