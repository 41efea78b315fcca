// Access to the parameter arrays of elements (elements/element.h) by their names in Model.
#pragma once

#include <array>

#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/vbd/differentiable_vbd.h"
#include "novaphy/vbd/elements/list.h"

namespace novaphy::vbd {

// Returns of(array) for each parameter array of an element, and of(empty array) up to kMostArrays.
// `m` is a model, or a struct of derivatives with the same names.
template <class Element, class M, class Of>
auto parameter_arrays(const M& m, const Of& of) {
  const Array none;
  std::array all = {of(none), of(none), of(none), of(none)};
  static_assert(all.size() == kMostArrays);
  size_t k = 0;
  Element::for_arrays(
      m, [&](const char*, const Array& array, int, ArrayUse) { all[k++] = of(array); });
  return all;
}

// Returns pointers to the parameters of a model on the host. The pointer to an activation is null,
// because the inputs of a step have the activations.
template <class Element>
std::array<const float*, kMostArrays> parameters_on_host(const Model& m) {
  std::array<const float*, kMostArrays> all = {};
  size_t k = 0;
  Element::for_arrays(m, [&](const char*, const Array& array, int, ArrayUse use) {
    all[k++] = use == kActivation ? nullptr : static_cast<const float*>(array.raw());
  });
  return all;
}

// Calls body(RoleIs<role>()) for the roles whose element has an activation.
template <class Body>
void for_activated_roles(const Body& body) {
  for_roles([&body](auto is) {
    if constexpr (decltype(is)::Slot::kActivated >= 0) body(is);
  });
}
template <class Slot>
const DeviceArray<float>& activation_in(const VbdStepInputs& in, const Model& m) {
  const DeviceArray<float>& given = Slot::activation(in.activations);
  return given.rows() != 0 ? given : Slot::activation(m);
}
inline VbdActivations activations_of(const Control* control, const Model& m) {
  VbdActivations all;
  for_activated_roles([&](auto is) {
    using Slot = typename decltype(is)::Slot;
    Slot::activation(all) = control != nullptr ? Slot::activation(*control) : Slot::activation(m);
  });
  return all;
}
// Returns the struct that holds an array with this use in a step: the activations or the model.
template <ArrayUse use>
const auto& source_of(const VbdActivations& activations, const Model& m) {
  if constexpr (use == kActivation) {
    return activations;
  } else {
    return m;
  }
}

}  // namespace novaphy::vbd
