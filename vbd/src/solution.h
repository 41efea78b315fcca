// The solution of a step of VBD, and what is linear there: Newton's method and a residual method
// over the sweeps of a step, which run on the CPU (TangentPass, ReversePass) or on a device
// (LaunchedSolution). The rows here are on the host in both cases.
#pragma once

#include <algorithm>
#include <cmath>

#include "krylov.h"
#include "novaphy/vbd/solver_vbd.h"
#include "rows.h"

namespace novaphy::vbd {

// J solution = load, J = -df/dx over the particles that move.
// step.sweep(r, z, image): z is what a sweep from 0 makes of the load r, image the derivative of
// the forces along it.
template <class Step>
KrylovResult solve_linear(Step& step, Rows& solution, Rows& load, double tolerance,
                          int32_t sweeps) {
  return solve_krylov(solution, load, tolerance, sweeps, [&](const Rows& r, Rows& z, Rows& image) {
    step.sweep(r, z, image);
    for (Row& row : image) row = -Vec3f(row);
  });
}

// The step of Newton's method, halved until the force falls, up to four times; then iterations
// instead, which cost less than the step did.
template <class Step>
VbdResidual try_newton(Step& step, const Rows& newton, const VbdResidual& now) {
  constexpr int kIterationsInstead = 20;
  const Rows start = step.starts(), x = step.positions(), moved = step.moves();
  Rows next_x = x, next_moved = moved;
  float part = 1.0f;
  for (int halvings = 0; halvings <= 4; ++halvings, part *= 0.5f) {
    for (size_t p = 0; p < x.size(); ++p) {
      if (step.is_held(p)) continue;
      next_moved[p] = Vec3f(moved[p]) + Vec3f(newton[p]) * part;
      next_x[p] = Vec3f(start[p]) + Vec3f(next_moved[p]);
    }
    step.place(next_x, next_moved);
    const VbdResidual next = step.residual();
    if (next.force < now.force) return next;
  }
  step.place(x, moved);
  for (int k = 0; k < kIterationsInstead; ++k) step.iterate_again();
  return step.residual();
}

// Until the relative residual is at most the tolerance, or twice what rounding allows, or
// `iterations` are over.
template <class Step>
VbdResidual solve_nonlinear(Step& step, double tolerance, int32_t iterations, int32_t sweeps) {
  VbdResidual now = step.residual();
  const auto is_solved = [tolerance](const VbdResidual& r) {
    return r.relative <= std::max(tolerance, 2.0 * r.floor);
  };
  for (int32_t k = 0; k < iterations && !is_solved(now); ++k) {
    Rows force = step.force(), newton;
    constexpr double kForcing = 1e-2;  // of the linear systems of an inexact Newton method
    solve_linear(step, newton, force, kForcing, sweeps);
    now = try_newton(step, newton, now);
  }
  return now;
}

// J^T solution = given, until the true residual is small enough: that of the recurrence drifts from
// it by rounding. step.reverse_sweep(r, z, left): a sweep in reverse from the load r, the
// multipliers z that it finds, and what they leave of r; step.balance(given, multipliers): what
// these leave of it, and beside that the derivatives by all that f reads.
template <class Step>
KrylovResult solve_transposed(Step& step, const Rows& given, double tolerance, int32_t sweeps) {
  const auto free_rows = [&step](Rows rows) {
    for (size_t p = 0; p < rows.size(); ++p)
      if (step.is_held(p)) rows[p] = Row();
    return rows;
  };
  Rows residual = free_rows(given), solution(given.size());
  const double scale = std::sqrt(inner(residual, residual));
  KrylovResult result;
  for (int round = 0; round < kRefinements; ++round) {
    // A sweep in reverse from r takes away from r what the multipliers z that it finds balance.
    Rows more;
    const double asked = kMargin * tolerance * (round > 0 ? 1.0 / result.residual : 1.0);
    const KrylovResult found = solve_krylov(more, residual, asked, sweeps - result.iterations,
                                            [&](const Rows& r, Rows& z, Rows& image) {
                                              Rows left;
                                              step.reverse_sweep(r, z, left);
                                              image = r;
                                              add_scaled(image, -1.0f, free_rows(std::move(left)));
                                            });
    add_scaled(solution, 1.0f, more);
    residual = free_rows(step.balance(given, solution));
    result.residual = scale == 0.0 ? 0.0 : std::sqrt(inner(residual, residual)) / scale;
    result.iterations += found.iterations;
    if (result.residual <= tolerance || result.iterations >= sweeps) break;
  }
  return result;
}

}  // namespace novaphy::vbd
