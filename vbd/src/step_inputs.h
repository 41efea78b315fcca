// The inputs of a step of VBD, and the outputs of its derivatives, as arguments of launches.
#pragma once

#include <span>
#include <vector>

#include "novaphy/core/launch_arguments.h"
#include "novaphy/vbd/differentiable_vbd.h"
#include "novaphy/vbd/elements/list.h"
#include "novaphy/vbd/rows_kernels.h"

namespace novaphy::vbd {

using StepInputs = VbdStepInputs;
using StepDerivatives = VbdStepDerivatives;

// Returns a pointer to the array, or null if the array has no rows.
template <class T>
const DeviceArray<T>* if_any(const DeviceArray<T>& array) {
  return array.rows() != 0 ? &array : nullptr;
}
inline Untyped if_any(const Array& array) {
  return array.rows() != 0 ? Untyped(array) : Untyped(static_cast<const void*>(nullptr));
}

// The rows of an array on the host: a copy if the array is on a device.
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
  const T* rows = nullptr;  // null: the array has no rows
};

// Returns whether a derivative with respect to an array of the use `wanted` is asked for. For
// materials the function skips elements whose damping terms always run.
inline bool wants(const StepDerivatives& d, ArrayUse wanted) {
  bool any = false;
  for_each_kind([&](auto is) {
    using Element = typename decltype(is)::Slot;
    if (wanted == kMaterial && Element::kIsAlwaysDamped) return;
    Element::for_arrays(d, [&](const char*, const Array& by, int, ArrayUse use) {
      any |= use == wanted && by.rows() != 0;
    });
  });
  return any;
}

}  // namespace novaphy::vbd
