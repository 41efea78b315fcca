// Vectors over the particles, as rows of 4 floats, for linear systems.
#pragma once

#include <span>
#include <vector>

#include "novaphy/core/device_array.h"
#include "novaphy/vbd/rows_kernels.h"

namespace novaphy::vbd {

using Row = VbdRow;
using Rows = std::vector<Row>;

static_assert(sizeof(Row) == sizeof(Vec4f));
inline Rows download(const DeviceArray<Vec4f>& from) {
  Rows rows(from.rows());
  from.Array::copy_to_host(rows.data(), from.bytes());
  return rows;
}
inline void upload_rows(DeviceArray<Vec4f>& to, const Rows& rows) {
  to.Array::copy_from_host(rows.data(), to.bytes());
}

// Returns the inner product in double precision, summed in the order of the particles.
inline double inner(const Rows& a, const Rows& b) {
  double sum = 0.0;
  for (size_t p = 0; p < a.size(); ++p)
    sum += (static_cast<double>(a[p].x) * static_cast<double>(b[p].x) +
            static_cast<double>(a[p].y) * static_cast<double>(b[p].y)) +
           static_cast<double>(a[p].z) * static_cast<double>(b[p].z);
  return sum;
}
// Adds s b to a.
inline void add_scaled(Rows& a, float s, const Rows& b) {
  for (size_t p = 0; p < a.size(); ++p) a[p] = Vec3f(a[p]) + Vec3f(b[p]) * s;
}

}  // namespace novaphy::vbd
