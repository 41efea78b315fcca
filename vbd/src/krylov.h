// A linear system A x = b by the generalised conjugate residual method (Eisenstat, Elman, Schultz
// 1983), restarted: for matrices that are not symmetric, with any preconditioner.
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "rows.h"

namespace novaphy::vbd {

// What is asked of the recurrence, whose residual drifts from the true one by rounding.
constexpr double kMargin = 0.5;
constexpr int kRefinements = 4;  // solutions of what the residual still is

struct KrylovResult {
  double residual = 0.0;  // |b - A x| / |b|, as the recurrence has it
  int32_t iterations = 0;
};

// x starts at 0 and residual at b. precondition(r, z, az): z = M^-1 r and az = A z.
template <class Precondition>
KrylovResult solve_krylov(Rows& x, Rows& residual, double tolerance, int32_t most,
                          Precondition&& precondition) {
  constexpr size_t kKept = 24;  // directions, before a restart
  std::vector<Rows> directions, images;
  std::vector<double> squares;
  const double scale = std::sqrt(inner(residual, residual));
  KrylovResult result;
  x.assign(residual.size(), Row());
  if (scale == 0.0) return result;
  result.residual = 1.0;
  while (result.iterations < most && result.residual > tolerance) {
    if (directions.size() == kKept) {
      directions.clear();
      images.clear();
      squares.clear();
    }
    Rows z(x.size()), az(x.size());
    precondition(residual, z, az);
    ++result.iterations;
    for (size_t k = 0; k < images.size(); ++k) {
      const auto part = static_cast<float>(inner(az, images[k]) / squares[k]);
      add_scaled(az, -part, images[k]);
      add_scaled(z, -part, directions[k]);
    }
    const double square = inner(az, az);
    if (!(square > 0.0) || !std::isfinite(square)) break;
    const auto step = static_cast<float>(inner(residual, az) / square);
    add_scaled(x, step, z);
    add_scaled(residual, -step, az);
    directions.push_back(std::move(z));
    images.push_back(std::move(az));
    squares.push_back(square);
    const double now = std::sqrt(inner(residual, residual)) / scale;
    if (!(now < result.residual) && directions.size() == 1) break;  // stagnates
    result.residual = now;
  }
  return result;
}

}  // namespace novaphy::vbd
