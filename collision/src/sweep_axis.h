// Internal: the axis along which shapes are swept.
#pragma once

#include <span>

#include "novaphy/collision/geometry/mesh_view.h"

namespace novaphy::detail {

// The axis on which the centres of the boxes vary most, the first among equals.
int sweep_axis(std::span<const geometry::Box3> boxes);

}  // namespace novaphy::detail
