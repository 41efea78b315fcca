// Solves a linear system A x = b by the generalized conjugate residual method (Eisenstat, Elman,
// Schultz 1983) with restarts. A need not be symmetric, and the preconditioner is arbitrary.
#pragma once

#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "rows.h"

namespace novaphy::vbd {

// The recurrence has to reach this part of the tolerance, because its residual drifts from the true
// one by rounding.
constexpr double kMargin = 0.5;
constexpr int kRefinements = 4;  // rounds of iterative refinement

struct KrylovResult {
  double residual = 0.0;  // |b - A x| / |b|, from the recurrence
  int32_t iterations = 0;
  double floor = 0.0;  // the part of `residual` that one rounding of x can cause; 0: not asked
};

// Solves A x = b by rounds of iterative refinement. more(tolerance, sweeps) adds a correction to x
// and returns its result. left(x) returns b - A x; it is called with the final x last. A residual
// above the tolerance gets its floor.
template <class More, class Left>
KrylovResult refine_solution(const Rows& x, double scale, double tolerance, int32_t sweeps,
                             const More& more, const Left& left) {
  KrylovResult result;
  for (int round = 0; round < kRefinements; ++round) {
    const double asked = kMargin * tolerance * (round > 0 ? 1.0 / result.residual : 1.0);
    result.iterations += more(asked, sweeps - result.iterations).iterations;
    const Rows remains = left(x);
    result.residual = scale == 0.0 ? 0.0 : std::sqrt(inner(remains, remains)) / scale;
    if (result.residual <= tolerance || result.iterations >= sweeps) break;
  }
  if (!(result.residual > tolerance)) return result;
  Rows rounded = x;
  uint32_t bits = 1;
  for (Row& row : rounded) {
    bits = bits * 1664525u + 1013904223u;
    row = Vec3f(row) * (1.0f + ((bits >> 31) != 0 ? 0x1p-23f : -0x1p-23f));
  }
  Rows change = left(rounded);
  add_scaled(change, -1.0f, left(x));
  result.floor = 0.5 * std::sqrt(inner(change, change)) / scale;
  return result;
}

// The last directions of a method and their images.
struct KeptDirections {
  static constexpr size_t kMost = 24;  // before a restart
  std::vector<Rows> directions, images;
  std::vector<double> sizes;

  void make_room() {
    if (sizes.size() == kMost) *this = {};
  }
  // Orthogonalizes an image against the vectors `of` (the directions or the images), and changes
  // the direction alike. sizes[k] is inner(images[k], of[k]).
  void take_from(Rows& direction, Rows& image, const std::vector<Rows>& of) const {
    for (size_t k = 0; k < sizes.size(); ++k) {
      const auto part = static_cast<float>(inner(image, of[k]) / sizes[k]);
      add_scaled(image, -part, images[k]);
      add_scaled(direction, -part, directions[k]);
    }
  }
  void keep(Rows direction, Rows image, double size) {
    directions.push_back(std::move(direction));
    images.push_back(std::move(image));
    sizes.push_back(size);
  }
};

// Solves for x, which starts at 0; `residual` starts at b. precondition(r, z, az) sets z = M^-1 r
// and az = A z.
template <class Precondition>
KrylovResult solve_krylov(Rows& x, Rows& residual, double tolerance, int32_t most,
                          Precondition&& precondition) {
  KeptDirections kept;
  const double scale = std::sqrt(inner(residual, residual));
  KrylovResult result;
  x.assign(residual.size(), Row());
  if (scale == 0.0) return result;
  result.residual = 1.0;
  while (result.iterations < most && result.residual > tolerance) {
    kept.make_room();
    Rows z(x.size()), az(x.size());
    precondition(residual, z, az);
    ++result.iterations;
    kept.take_from(z, az, kept.images);
    const double square = inner(az, az);
    if (!(square > 0.0) || !std::isfinite(square)) break;
    const auto step = static_cast<float>(inner(residual, az) / square);
    add_scaled(x, step, z);
    add_scaled(residual, -step, az);
    kept.keep(std::move(z), std::move(az), square);
    const double now = std::sqrt(inner(residual, residual)) / scale;
    if (!(now < result.residual) && kept.sizes.size() == 1) break;  // the iteration stagnates
    result.residual = now;
  }
  return result;
}

}  // namespace novaphy::vbd
