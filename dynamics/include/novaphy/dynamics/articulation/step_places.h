// Index-based access to the arrays of step_arrays.h, for loops over the arrays of a step.
#pragma once

#include <type_traits>
#include <utility>

#include "novaphy/dynamics/articulation/step_arrays.h"

namespace novaphy {

// Returns the index of each array in the list.
constexpr articulation::StepArrays<articulation::Each<int32_t>> places_of_step_arrays() {
  articulation::StepArrays<articulation::Each<int32_t>> places = {};
  int32_t next = 0;
  articulation::for_each_array([&](int32_t& place) { place = next++; }, places);
  return places;
}
inline constexpr auto kAt = places_of_step_arrays();
inline constexpr size_t kGradientArrays = kAt.X_p;  // number of arrays with a gradient
inline constexpr size_t kStepArrays = kAt.axis + 1;

struct StepRow {
  articulation::RowOf of = articulation::RowOf::Dof;
  int32_t width = 0;
};
struct StepRows {
  StepRow at[kStepArrays] = {};
};
constexpr StepRows rows_of_step_arrays() {
  StepRows rows = {};
  constexpr articulation::StepArrays<articulation::StepShape> shapes = {};
  articulation::for_each_array(
      [&](auto of, int32_t place) {
        rows.at[place] = {of.kRowOf, of.kWidth};
      },
      shapes, kAt);
  return rows;
}
inline constexpr StepRows kStepRows = rows_of_step_arrays();

// Sets the pointers of the arrays with a gradient, or of all arrays, from `to`, in the order of the
// list.
template <class Arrays, class T>
void point_gradient_arrays(Arrays& arrays, T* const* to) {
  articulation::for_each_gradient_array(
      [&](auto& array) {
        array = reinterpret_cast<std::remove_reference_t<decltype(array)>>(*to++);
      },
      arrays);
}
template <class Arrays, class T>
void point_arrays(Arrays& arrays, T* const* to) {
  articulation::for_each_array(
      [&](auto& array) {
        array = reinterpret_cast<std::remove_reference_t<decltype(array)>>(*to++);
      },
      arrays);
}

// Makes the arrays from argument(index), in the order of the list.
template <class Arrays, int32_t first, class Argument, size_t... k>
Arrays step_arguments(const Argument& argument, std::index_sequence<k...>) {
  return {argument(first + static_cast<int32_t>(k))...};
}

}  // namespace novaphy
