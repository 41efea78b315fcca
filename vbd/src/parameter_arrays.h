// The arrays of the parameters of elements (slot_numbers_law.h), by their names in Model.
#pragma once

#include <array>

#include "novaphy/core/sim/model.h"
#include "novaphy/vbd/slot_numbers_law.h"

namespace novaphy::vbd {

// What `of` makes of each array, and of `none` where a role has fewer. `m`: a model, or the
// derivatives by its arrays.
template <class M, class None, class Of>
auto parameter_arrays(Role role, const M& m, const None& none, const Of& of) {
  using All = std::array<decltype(of(m.particle_tri_area)), kParameterArrays>;
  switch (role) {
    case kSpring:
      return All{of(m.particle_spring_stiffness), of(m.particle_spring_damping),
                 of(m.particle_spring_rest_length), of(none)};
    case kTriangle:
      return All{of(m.particle_tri_pose), of(m.particle_tri_area), of(m.particle_tri_material),
                 of(m.particle_tri_activation)};
    case kTetrahedron:
      return All{of(m.particle_tet_pose), of(m.particle_tet_material),
                 of(m.particle_tet_activation), of(none)};
    default:
      return All{of(m.particle_edge_material), of(m.particle_edge_rest_length),
                 of(m.particle_edge_rest_angle), of(none)};
  }
}

// Of a model on the host: rows of floats.
inline std::array<const float*, kParameterArrays> parameters_on_host(Role role, const Model& m) {
  return parameter_arrays(
      role, m, Array(), [](const Array& array) { return static_cast<const float*>(array.raw()); });
}

}  // namespace novaphy::vbd
