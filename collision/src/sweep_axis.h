// Internal: the choice of the axis for sweep and prune.
#pragma once

#include <cmath>

#include "novaphy/collision/geometry/mesh_view.h"

namespace novaphy::detail {

// Returns the axis on which the centers of the boxes vary most, or the first of several such axes.
// `box_of` returns the box of a row.
template <class Rows, class BoxOf>
int sweep_axis(const Rows& rows, const BoxOf& box_of) {
  double sum[3] = {}, square[3] = {}, count = 0.0;
  for (const auto& row : rows) {
    const geometry::Box3& box = box_of(row);
    for (int k = 0; k < 3; ++k) {
      const double c = 0.5 * (static_cast<double>(geometry::component(box.lo, k)) +
                              static_cast<double>(geometry::component(box.hi, k)));
      if (!std::isfinite(c)) continue;  // skip unbounded boxes
      sum[k] += c;
      square[k] += c * c;
    }
    count += 1.0;
  }
  int best = 0;
  double most = -1.0;
  for (int k = 0; k < 3; ++k) {
    const double variance = count > 0.0 ? square[k] / count - sum[k] / count * (sum[k] / count) : 0;
    if (variance > most) {
      most = variance;
      best = k;
    }
  }
  return best;
}

}  // namespace novaphy::detail
