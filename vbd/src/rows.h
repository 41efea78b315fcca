// Vectors over the particles, as rows of 4 floats, for linear systems.
#pragma once

#include <vector>

#include "step_work.h"

namespace novaphy::vbd {

using Rows = std::vector<Row>;

inline float* floats(Rows& rows) { return reinterpret_cast<float*>(rows.data()); }

// In double precision, in the order of the particles.
inline double inner(const Rows& a, const Rows& b) {
  double sum = 0.0;
  for (size_t p = 0; p < a.size(); ++p)
    sum += (static_cast<double>(a[p].x) * static_cast<double>(b[p].x) +
            static_cast<double>(a[p].y) * static_cast<double>(b[p].y)) +
           static_cast<double>(a[p].z) * static_cast<double>(b[p].z);
  return sum;
}
// a += s b.
inline void add_scaled(Rows& a, float s, const Rows& b) {
  for (size_t p = 0; p < a.size(); ++p) a[p] = Vec3f(a[p]) + Vec3f(b[p]) * s;
}

}  // namespace novaphy::vbd
