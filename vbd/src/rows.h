// Vectors over the particles for linear systems, stored as rows of 4 floats.
#pragma once

#include <algorithm>
#include <cmath>
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

using Numbers = std::vector<double>;  // one value for each connected component
using Flags = std::vector<char>;      // one flag for each connected component
inline bool any(const Flags& flags) {
  return std::any_of(flags.begin(), flags.end(), [](char flag) { return flag != 0; });
}

// The connected components of the particles that move. Sums run over each component separately, so
// that a component does not influence the results of other components.
struct Components {
  const std::vector<int32_t>& of;  // component of each particle; -1: kinematic
  size_t count;

  // Calls body(particle, component) for each particle that moves.
  template <class Body>
  void visit(const Body& body) const {
    for (size_t p = 0; p < of.size(); ++p)
      if (of[p] >= 0) body(p, static_cast<size_t>(of[p]));
  }
  // Returns the inner product of each component in double precision, summed in the order of the
  // particles.
  Numbers inner(const Rows& a, const Rows& b) const {
    Numbers sum(count);
    visit([&](size_t p, size_t c) {
      sum[c] += (static_cast<double>(a[p].x) * static_cast<double>(b[p].x) +
                 static_cast<double>(a[p].y) * static_cast<double>(b[p].y)) +
                static_cast<double>(a[p].z) * static_cast<double>(b[p].z);
    });
    return sum;
  }
  Numbers norms(const Rows& a) const {
    Numbers all = inner(a, a);
    for (double& number : all) number = std::sqrt(number);
    return all;
  }
  // Adds sign s b to a, with one factor s for each component.
  template <class Scale>
  void add_scaled(Rows& a, const std::vector<Scale>& s, const Rows& b, float sign = 1.0f) const {
    visit([&](size_t p, size_t c) {
      if (s[c] != 0) a[p] = Vec3f(a[p]) + Vec3f(b[p]) * (sign * static_cast<float>(s[c]));
    });
  }
};

}  // namespace novaphy::vbd
