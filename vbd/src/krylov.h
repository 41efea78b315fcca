// Solves a linear system A x = b for each connected component by the generalized conjugate residual
// method with restarts (Eisenstat, Elman, Schultz 1983). A need not be symmetric, and any
// preconditioner is allowed.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "rows.h"

namespace novaphy::vbd {

// The tolerance of the recurrence as a part of the wanted tolerance. Rounding separates the
// residual of the recurrence from the true residual.
constexpr double kMargin = 0.5;
constexpr int kRefinements = 4;  // rounds of iterative refinement

struct KrylovResult {
  double residual = 0.0;  // |b - A x| / |b|
  int32_t iterations = 0;
  double floor = 0.0;  // part of `residual` that one rounding of x can cause; 0: not computed

  // Returns the largest residual that counts as solved: the tolerance, or four times the floor up
  // to ten tolerances. The bound exists because near a singular matrix one rounding of x can cause
  // any residual.
  double allowed(double tolerance) const {
    return std::max(tolerance, std::min(4.0 * floor, 10.0 * tolerance));
  }
};

// Solves A x = b for each component by rounds of iterative refinement. more(tolerances, results)
// adds a correction to x and counts iterations. left(x) returns b - A x. The last call of left has
// the final x. If the residual of a component is above the tolerance, the function also computes
// its floor. Returns the result of the component with the largest ratio of residual to allowed
// residual.
template <class More, class Left>
KrylovResult refine_solution(const Components& of, const Rows& x, const Rows& load,
                             double tolerance, int32_t sweeps, const More& more, const Left& left) {
  const Numbers scale = of.norms(load);
  std::vector<KrylovResult> results(of.count);
  Flags runs(of.count, 1);
  for (int round = 0; round < kRefinements && any(runs); ++round) {
    Numbers asked(of.count, 1.0);  // a tolerance of 1 asks for no correction
    for (size_t c = 0; c < of.count; ++c)
      if (runs[c] != 0)
        asked[c] = kMargin * tolerance * (round > 0 ? 1.0 / results[c].residual : 1.0);
    more(asked, results);
    const Numbers remains = of.norms(left(x));
    for (size_t c = 0; c < of.count; ++c) {
      results[c].residual = scale[c] == 0.0 ? 0.0 : remains[c] / scale[c];
      runs[c] = results[c].residual > tolerance && results[c].iterations < sweeps;
    }
  }
  const auto is_above = [&](const KrylovResult& r) { return r.residual > tolerance; };
  if (std::any_of(results.begin(), results.end(), is_above)) {
    Rows rounded = x;
    uint32_t bits = 1;
    for (Row& row : rounded) {
      bits = bits * 1664525u + 1013904223u;
      row = Vec3f(row) * (1.0f + ((bits >> 31) != 0 ? 0x1p-23f : -0x1p-23f));
    }
    Rows change = left(rounded);
    of.add_scaled(change, Flags(of.count, 1), left(x), -1.0f);
    const Numbers changes = of.norms(change);
    for (size_t c = 0; c < of.count; ++c)
      if (is_above(results[c])) results[c].floor = 0.5 * changes[c] / scale[c];
  }
  KrylovResult worst;
  for (const KrylovResult& r : results) {
    const int32_t most = std::max(worst.iterations, r.iterations);
    const double ratio = r.residual / r.allowed(tolerance);
    if (!(ratio <= worst.residual / worst.allowed(tolerance))) worst = r;
    worst.iterations = most;
    if (std::isnan(ratio)) break;
  }
  return worst;
}

// The last search directions of a method, and their images under A.
struct StoredDirections {
  static constexpr size_t kMost = 24;  // count of directions before a restart
  const Components& components;
  std::vector<Rows> directions, images;
  std::vector<Numbers> sizes;

  void make_room() {
    if (sizes.size() < kMost) return;
    directions.clear();
    images.clear();
    sizes.clear();
  }
  // Subtracts from `image` its parts along images[k], and from `direction` the same multiples of
  // directions[k]. Afterwards `image` is orthogonal to the vectors `of`, which are the directions
  // or the images. sizes[k] is inner(images[k], of[k]).
  void take_from(Rows& direction, Rows& image, const std::vector<Rows>& of) const {
    for (size_t k = 0; k < sizes.size(); ++k) {
      Numbers part = components.inner(image, of[k]);
      for (size_t c = 0; c < part.size(); ++c) part[c] /= sizes[k][c];
      components.add_scaled(image, part, images[k], -1.0f);
      components.add_scaled(direction, part, directions[k], -1.0f);
    }
  }
  void keep(Rows direction, Rows image, Numbers size) {
    directions.push_back(std::move(direction));
    images.push_back(std::move(image));
    sizes.push_back(std::move(size));
  }
};

// Solves A x = b. On entry x is 0 and `residual` is b. precondition(r, z, az) sets z = M^-1 r and
// az = A z, with the preconditioner M. A component ends at its tolerance, or when its result has
// counted `most` iterations.
template <class Precondition>
void solve_krylov(const Components& of, Rows& x, Rows& residual, const Numbers& tolerance,
                  int32_t most, std::vector<KrylovResult>& results, Precondition&& precondition) {
  StoredDirections kept{of, {}, {}, {}};
  const Numbers scale = of.norms(residual);
  Numbers now(of.count, 1.0);
  Flags runs(of.count);
  const auto goes_on = [&](size_t c) {
    return now[c] > tolerance[c] && results[c].iterations < most;
  };
  for (size_t c = 0; c < of.count; ++c) runs[c] = scale[c] != 0.0 && goes_on(c);
  x.assign(residual.size(), Row());
  while (any(runs)) {
    kept.make_room();
    Rows z(x.size()), az(x.size());
    precondition(residual, z, az);
    kept.take_from(z, az, kept.images);
    Numbers square = of.inner(az, az), step = of.inner(residual, az);
    for (size_t c = 0; c < of.count; ++c) {
      results[c].iterations += runs[c];
      runs[c] = runs[c] != 0 && square[c] > 0.0 && std::isfinite(square[c]);
      step[c] = runs[c] != 0 ? step[c] / square[c] : 0.0;
    }
    of.add_scaled(x, step, z);
    of.add_scaled(residual, step, az, -1.0f);
    const Numbers left = of.norms(residual);
    for (size_t c = 0; c < of.count; ++c) {
      if (runs[c] == 0) continue;
      const bool stagnates = kept.sizes.empty() && !(left[c] / scale[c] < now[c]);
      now[c] = left[c] / scale[c];
      runs[c] = !stagnates && goes_on(c);
    }
    kept.keep(std::move(z), std::move(az), std::move(square));
  }
}

}  // namespace novaphy::vbd
