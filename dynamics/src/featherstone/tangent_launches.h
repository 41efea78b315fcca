// The kernels that tangents of steps of articulations launch on devices.
#pragma once

#include "articulation_contact_jvp_kernels.h"
#include "articulation_jvp_kernels.h"
#include "articulation_step.h"
#include "novaphy/core/device_kernel.h"

namespace novaphy {
namespace detail {
const char* articulation_contact_jvp_kernels_source();
const char* articulation_jvp_kernels_source();
}  // namespace detail

struct TangentKernels {
  Kernel<DualPackArguments> pack{dual_pack, detail::articulation_jvp_kernels_source};
  Kernel<ArticulationJvpArguments> step{kInChunks<articulation_step_jvp, kTreeRows>,
                                        detail::articulation_jvp_kernels_source};
  Kernel<ArticulationContactJvpArguments> contact_step{
      kInChunks<articulation_contact_jvp, kTreeRows>,
      detail::articulation_contact_jvp_kernels_source};
  Kernel<DualTangentArguments> tangent{dual_tangent, detail::articulation_jvp_kernels_source};
};
// The object is never destroyed, because recordings refer to the kernels.
inline const TangentKernels& tangent_kernels() {
  static const auto& all = *new TangentKernels;
  return all;
}

}  // namespace novaphy
