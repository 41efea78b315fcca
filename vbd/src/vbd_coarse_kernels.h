// The coarse correction of VBD as kernels (coarse_kernels.h). The sums over the particles of an
// aggregate and over the functions of a system have a fixed order. The bits of the result therefore
// do not depend on the number of threads.
#pragma once

#include "novaphy/core/block_kernel.h"
#include "novaphy/vbd/coarse_kernels.h"

namespace novaphy {

// Compute parts of the correction for particles. A row is a lane of the groups of the launch.
NOVAPHY_ROW_KERNEL(vbd_coarse_rows, VbdCoarseArguments) {
  vbd::coarse_rows(a, vbd::LaneGroup<float>(a.sweep, row));
}
NOVAPHY_ROW_KERNEL(vbd_coarse_force, VbdCoarseArguments) {
  vbd::coarse_force(a, vbd::LaneGroup<float>(a.sweep, row));
}
NOVAPHY_ROW_KERNEL(vbd_coarse_outer, VbdCoarseArguments) {
  vbd::coarse_outer(a, vbd::LaneGroup<float>(a.sweep, row));
}

namespace vbd {

// A system: its first function, its number of unknowns, and its matrix, column by column.
struct CoarseSystem {
  int64_t first, unknowns;
  float* matrix;
  CoarseSystem(const VbdCoarseArguments& a, int32_t system)
      : first(a.function_begin[a.system_begin[system]]),
        unknowns(3 * (a.function_begin[a.system_begin[system + 1]] - first)),
        matrix(a.matrix + a.matrix_begin[system]) {}
  float* column(int64_t j) const { return matrix + j * unknowns; }
};

// Returns the dot product of a and b, in four partial sums.
inline float coarse_dot(const float* a, const float* b, int64_t count) {
  float sum[4] = {};
  int64_t k = 0;
  for (; k + 4 <= count; k += 4)
    for (int64_t part = 0; part < 4; ++part) sum[part] = sum[part] + a[k + part] * b[k + part];
  for (int64_t part = 0; k < count; ++k, ++part) sum[part] = sum[part] + a[k] * b[k];
  return (sum[0] + sum[1]) + (sum[2] + sum[3]);
}

}  // namespace vbd

// Computes the 3x3 block of A for a pair of functions. A row is a pair of functions.
NOVAPHY_ROW_KERNEL(vbd_coarse_matrix, VbdCoarseArguments) {
  const int32_t g = a.pairs[2 * row], h = a.pairs[2 * row + 1];
  const int32_t from = a.function_aggregate[g], to = a.function_aggregate[h];
  const int32_t of_g = g - a.function_begin[from], of_h = h - a.function_begin[to];
  float sum[9] = {};
  for (int32_t m = a.member_begin[from]; m < a.member_begin[from + 1]; ++m) {
    const int32_t p = a.members[m];
    const float* const h_p = vbd::rows_of(a, p, to);
    if (h_p == nullptr) continue;
    const float value = vbd::function_at(a, p, of_g);
    for (int k = 0; k < 9; ++k) sum[k] = sum[k] + value * h_p[9 * of_h + k];
  }
  const vbd::CoarseSystem s(a, a.system[from]);
  for (int r = 0; r < 3; ++r)
    for (int c = 0; c < 3; ++c)
      s.matrix[(3 * (h - s.first) + c) * s.unknowns + 3 * (g - s.first) + r] = sum[3 * r + c];
}

// Computes P^T f. A row is a function.
NOVAPHY_ROW_KERNEL(vbd_coarse_load, VbdCoarseArguments) {
  const int32_t aggregate = a.function_aggregate[row];
  if (a.tests != 0 && a.search[a.system[aggregate]].is_done != 0.0f) return;
  const auto number = static_cast<int32_t>(row - a.function_begin[aggregate]);
  Vec3f sum;
  for (int32_t m = a.member_begin[aggregate]; m < a.member_begin[aggregate + 1]; ++m) {
    const int32_t p = a.members[m];
    sum = sum + to_vec3(a.force[p]) * vbd::function_at(a, p, number);
  }
  a.load[3 * row] = sum.x;
  a.load[3 * row + 1] = sum.y;
  a.load[3 * row + 2] = sum.z;
}

namespace vbd {

// The columns between two waits of the threads of a block.
constexpr int64_t kCoarsePanel = 8;

// Factorizes column j: subtracts the columns [first, j) of its panel, and divides by the pivot.
inline void coarse_finish_column(const CoarseSystem& s, int64_t first, int64_t j, float diagonal) {
  float* const column = s.column(j);
  for (int64_t k = first; k < j; ++k) {
    const float* const before = s.column(k);
    const float factor = column[k];
    for_block(j, s.unknowns, [&](int64_t i) { column[i] = column[i] - factor * before[i]; });
  }
  wait_for_block();
  const float inverse = column[j] > 1e-6f * diagonal ? 1.0f / column[j] : 0.0f;
  wait_for_block();
  for_block(j + 1, s.unknowns, [&](int64_t i) {
    s.column(i)[j] = column[i];
    column[i] = column[i] * inverse;
  });
  if (is_first_of_block()) column[j] = inverse;
  wait_for_block();
}

// Subtracts the products of the panel from the columns behind the panel.
inline void coarse_subtract_panel(const CoarseSystem& s, int64_t first) {
  const float* const panel = s.column(first);
  for (int64_t j = first + kCoarsePanel; j < s.unknowns; ++j) {
    float* const column = s.column(j);
    float factors[kCoarsePanel];
    for (int64_t w = 0; w < kCoarsePanel; ++w) factors[w] = column[first + w];
    for_block(j, s.unknowns, [&](int64_t i) {
      float value = column[i];
      for (int64_t w = 0; w < kCoarsePanel; ++w)
        value = value - factors[w] * panel[w * s.unknowns + i];
      column[i] = value;
    });
  }
  wait_for_block();
}

}  // namespace vbd

// Factorizes A = L U. L has a diagonal of 1 and lies below the diagonal, U lies above, and the
// diagonal has the inverse of that of U. An unknown whose pivot is at most 1e-6 of its diagonal
// entry of A is left out. A block is a system.
NOVAPHY_SHARED_BLOCK_KERNEL(vbd_coarse_factor, VbdCoarseArguments) {
  a.search[block].whole = 0.0f;
  const vbd::CoarseSystem s(a, static_cast<int32_t>(block));
  float* const diagonal = a.step + 3 * s.first;  // no step is kept there yet
  for_block(0, s.unknowns, [&](int64_t j) { diagonal[j] = s.column(j)[j]; });
  wait_for_block();
  for (int64_t first = 0; first < s.unknowns; first += vbd::kCoarsePanel) {
    for (int64_t j = first; j < first + vbd::kCoarsePanel && j < s.unknowns; ++j)
      vbd::coarse_finish_column(s, first, j, diagonal[j]);
    vbd::coarse_subtract_panel(s, first);
  }
}

namespace vbd {

// The unknowns of a panel, which each thread of a block computes.
struct CoarsePanel {
  int64_t first, width;
  float x[kCoarsePanel] = {};
  CoarsePanel(const CoarseSystem& s, int64_t begin)
      : first(begin), width(s.unknowns - begin < kCoarsePanel ? s.unknowns - begin : kCoarsePanel) {
  }
  void write(float* step) const {
    wait_for_block();
    for (int64_t w = 0; w < kCoarsePanel; ++w)
      if (is_first_of_block() && w < width) step[first + w] = x[w];
  }
};

// Solves L y = step in place, by panels of columns.
inline void coarse_solve_lower(const CoarseSystem& s, float* step) {
  for (int64_t first = 0; first < s.unknowns; first += kCoarsePanel) {
    const float* const columns = s.column(first);
    CoarsePanel y(s, first);
    for (int64_t w = 0; w < kCoarsePanel; ++w) {
      if (w >= y.width) continue;
      y.x[w] = step[first + w];
      for (int64_t v = 0; v < w; ++v)
        y.x[w] = y.x[w] - y.x[v] * columns[v * s.unknowns + first + w];
    }
    y.write(step);
    for_block(first + kCoarsePanel, s.unknowns, [&](int64_t i) {
      float sum = step[i];
      for (int64_t w = 0; w < kCoarsePanel; ++w) sum = sum - y.x[w] * columns[w * s.unknowns + i];
      step[i] = sum;
    });
    wait_for_block();
  }
}
// Solves U x = step in place, by panels of columns from the last one.
inline void coarse_solve_upper(const CoarseSystem& s, float* step) {
  for (int64_t first = (s.unknowns - 1) / kCoarsePanel * kCoarsePanel; first >= 0;
       first -= kCoarsePanel) {
    const float* const columns = s.column(first);
    CoarsePanel x(s, first);
    for (int64_t w = kCoarsePanel; w-- > 0;) {
      if (w >= x.width) continue;
      x.x[w] = step[first + w];
      for (int64_t v = kCoarsePanel; v-- > w + 1;)
        if (v < x.width) x.x[w] = x.x[w] - x.x[v] * columns[v * s.unknowns + first + w];
      x.x[w] = x.x[w] * columns[w * s.unknowns + first + w];
    }
    x.write(step);
    for_block(0, first, [&](int64_t i) {
      float sum = step[i];
      for (int64_t w = kCoarsePanel; w-- > 0;)
        if (w < x.width) sum = sum - x.x[w] * columns[w * s.unknowns + i];
      step[i] = sum;
    });
    wait_for_block();
  }
}

}  // namespace vbd

// Solves A a = P^T f for the step a, and starts the line search. A block is a system.
NOVAPHY_SHARED_BLOCK_KERNEL(vbd_coarse_solve, VbdCoarseArguments) {
  const vbd::CoarseSystem s(a, static_cast<int32_t>(block));
  const float* const load = a.load + 3 * s.first;
  float* const step = a.step + 3 * s.first;
  for_block(0, s.unknowns, [&](int64_t i) { step[i] = load[i]; });
  wait_for_block();
  vbd::coarse_solve_lower(s, step);
  vbd::coarse_solve_upper(s, step);
  if (!is_first_of_block()) return;
  VbdCoarseSearch& search = a.search[block];
  search.length = 1.0f;
  search.slope = vbd::coarse_dot(load, step, s.unknowns);
  search.is_done = search.slope <= kVbdCoarseTrust * search.whole ? 1.0f : 0.0f;
}

// Ends the line search if the step is short enough, or halves the length t. A row is a system.
NOVAPHY_ROW_KERNEL(vbd_coarse_test, VbdCoarseArguments) {
  VbdCoarseSearch& search = a.search[row];
  if (search.is_done != 0.0f) return;
  const vbd::CoarseSystem s(a, static_cast<int32_t>(row));
  const float slope = vbd::coarse_dot(a.load + 3 * s.first, a.step + 3 * s.first, s.unknowns);
  if (slope >= -0.5f * search.slope) {
    search.is_done = 1.0f;
    if (search.length == 1.0f) search.whole = search.slope;
  } else {
    search.length = a.tests == kVbdCoarseTests ? 0.0f : 0.5f * search.length;
  }
}

namespace vbd {

// Returns the displacement (m) of a particle by the coarse step with the given length t.
inline Vec3f coarse_field(const VbdCoarseArguments& a, int32_t particle, float length) {
  const int32_t aggregate = a.aggregate[particle], first = a.function_begin[aggregate];
  Vec3f sum;
  for (int32_t g = first; g < a.function_begin[aggregate + 1]; ++g) {
    const float* const step = a.step + 3 * static_cast<int64_t>(g);
    sum = sum + Vec3f{step[0], step[1], step[2]} * function_at(a, particle, g - first);
  }
  return sum * length;
}

}  // namespace vbd

// Moves the particles by the step with the current length of the line search. A row is a particle.
NOVAPHY_ROW_KERNEL(vbd_coarse_try, VbdCoarseArguments) {
  const auto p = static_cast<int32_t>(row);
  const int32_t s = vbd::system_of(a, p);
  if (s < 0 || a.search[s].is_done != 0.0f) return;
  const Vec3f moved = to_vec3(a.sweep.moved[p]) + vbd::coarse_field(a, p, a.search[s].length);
  a.sweep.x[p] = to_row(to_vec3(a.sweep.start[p]) + moved);
}
// Moves the particles by the step with the length that the line search found. A row is a particle.
NOVAPHY_ROW_KERNEL(vbd_coarse_take, VbdCoarseArguments) {
  const auto p = static_cast<int32_t>(row);
  const int32_t s = vbd::system_of(a, p);
  if (s < 0) return;
  const float length = a.search[s].length;
  Vec3f moved = to_vec3(a.sweep.moved[p]);
  if (length > 0.0f) moved = moved + vbd::coarse_field(a, p, length);
  a.sweep.moved[p] = to_row(moved);
  a.sweep.x[p] = to_row(to_vec3(a.sweep.start[p]) + moved);
}
// For the reverse pass: writes the fields P a to sweep.moved, and t P a to force. A row is a
// particle.
NOVAPHY_ROW_KERNEL(vbd_coarse_fields, VbdCoarseArguments) {
  const auto p = static_cast<int32_t>(row);
  const int32_t s = vbd::system_of(a, p);
  const Vec3f field = s < 0 ? Vec3f{} : vbd::coarse_field(a, p, 1.0f);
  a.sweep.moved[p] = to_row(field);
  a.force[p] = to_row(s < 0 ? Vec3f{} : field * a.search[s].length);
}

// Computes the translation of a free system that balances its forces. A row is a system.
NOVAPHY_ROW_KERNEL(vbd_coarse_balance, VbdCoarseArguments) {
  vbd::Block<float> sum;
  const int32_t first = a.system_begin[row], end = a.system_begin[row + 1];
  for (int32_t m = a.member_begin[first]; a.is_free[row] != 0 && m < a.member_begin[end]; ++m) {
    const int32_t p = a.members[m];
    const float* const h = a.rows + 9 * a.near_row[a.near_begin[p]];
    sum = sum + vbd::Block<float>{to_vec3(a.force[p]), h[0], h[1], h[2], h[3], h[4], h[5]};
  }
  a.shift[row] = to_row({});
  if (a.is_free[row] != 0)
    a.shift[row] =
        to_row(vbd::solve_block(vbd::factorize(sum, a.sweep.regularization.value), sum.f));
}
// Moves the particles of free systems by the translation of vbd_coarse_balance. A row is a
// particle.
NOVAPHY_ROW_KERNEL(vbd_coarse_shift, VbdCoarseArguments) {
  const auto p = static_cast<int32_t>(row);
  const int32_t s = vbd::system_of(a, p);
  if (s < 0 || a.is_free[s] == 0) return;
  const Vec3f moved = to_vec3(a.sweep.moved[p]) + to_vec3(a.shift[s]);
  a.sweep.moved[p] = to_row(moved);
  a.sweep.x[p] = to_row(to_vec3(a.sweep.start[p]) + moved);
}

}  // namespace novaphy
