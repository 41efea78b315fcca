#include "novaphy/core/builtin_kernels.h"

namespace novaphy {

// Never destroyed, because recordings refer to the kernels.
const Kernel<ScanArguments>& exclusive_scan() {
  static const auto& kernel = *new Kernel<ScanArguments>("exclusive_scan_i32");
  return kernel;
}
const Kernel<SortArguments>& sort_by_key() {
  static const auto& kernel = *new Kernel<SortArguments>("sort_by_key_i32");
  return kernel;
}
const Kernel<IncidenceArguments>& incidence() {
  static const auto& kernel = *new Kernel<IncidenceArguments>("incidence_i32");
  return kernel;
}

}  // namespace novaphy
