// The inputs of a step of VBD, and the destinations of its derivatives, as arguments of launches.
#pragma once

#include <span>
#include <vector>

#include "novaphy/core/launch_arguments.h"
#include "novaphy/vbd/differentiable_vbd.h"
#include "novaphy/vbd/rows_kernels.h"

namespace novaphy::vbd {

using StepInputs = VbdStepInputs;
using StepDerivatives = VbdStepDerivatives;

// Null where there are no rows.
template <class T>
const DeviceArray<T>* if_any(const DeviceArray<T>& array) {
  return array.rows() != 0 ? &array : nullptr;
}
inline Untyped if_any(const Array& array) {
  return array.rows() != 0 ? Untyped(array) : Untyped(static_cast<const void*>(nullptr));
}

// Numbers for the host to read: a copy, where they are on a device.
template <class T>
struct OnHost {
  explicit OnHost(const Array& array) {
    if (array.rows() == 0) return;
    if (!array.device().is_cpu()) {
      copy.resize(array.bytes() / sizeof(T));
      array.copy_to_host(copy.data(), array.bytes());
    }
    rows = copy.empty() ? static_cast<const T*>(array.raw()) : copy.data();
  }
  std::vector<T> copy;
  const T* rows = nullptr;  // null: none
};

// Whether a derivative by a damping is wanted, for which its terms run although it is 0.
inline bool wants_damping(const StepDerivatives& d) {
  return d.particle_tri_material.rows() != 0 || d.particle_edge_material.rows() != 0 ||
         d.particle_tet_material.rows() != 0;
}
// Whether a derivative by a rest shape is wanted.
inline bool wants_weights(const StepDerivatives& d) {
  return d.particle_tri_pose.rows() != 0 || d.particle_tet_pose.rows() != 0;
}

}  // namespace novaphy::vbd
