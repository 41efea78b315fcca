// Solves a step of VBD to convergence, and linear systems at its solution. Newton's method and a
// Krylov method use the sweeps of a step (StepTangent, StepAdjoint), which run on the model's
// device. The vectors here are on the host.
#pragma once

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "krylov.h"
#include "novaphy/vbd/solver_vbd.h"
#include "rows.h"

namespace novaphy::vbd {

// Solves J solution = load, with J = -df/dx over the particles that move. step.sweep(r, z, image)
// sets z to the result of a sweep from 0 for the load r, and image to the tangent of the forces
// along z.
template <class Step>
KrylovResult solve_linear(Step& step, Rows& solution, Rows& load, double tolerance,
                          int32_t sweeps) {
  return solve_krylov(solution, load, tolerance, sweeps, [&](const Rows& r, Rows& z, Rows& image) {
    step.sweep(r, z, image);
    for (Row& row : image) row = -Vec3f(row);
  });
}

// Returns whether the energy falls along a whole step. `before` are the forces at its start. The
// forces have to push along the step in its first half. Their work over the step, by Simpson's
// rule, has to be positive. The function leaves the particles at the end of the step.
template <class Step>
bool falls_along(Step& step, const Rows& start, const Rows& before, const Rows& moved,
                 const Rows& newton, float part) {
  Rows x = start, now = moved;
  const auto force_at = [&](float where) {
    for (size_t p = 0; p < x.size(); ++p) {
      if (step.is_held(p)) continue;
      now[p] = Vec3f(moved[p]) + Vec3f(newton[p]) * where;
      x[p] = Vec3f(start[p]) + Vec3f(now[p]);
    }
    step.place(x, now);
    return step.force();
  };
  const double middle = inner(force_at(0.5f * part), newton), end = inner(force_at(part), newton);
  const double first = inner(before, newton);
  return first > 0.0 && middle > 0.0 && end > -0.5 * first && first + 4.0 * middle + end > 0.0;
}

// Tries the step of Newton's method, and halves it up to four times until the energy falls along
// it. Returns false, with the old positions, if no length helps.
template <class Step>
bool try_newton(Step& step, const Rows& force, const Rows& newton) {
  const Rows x = step.positions(), moved = step.moves();
  // Kinematic particles stay where they are.
  Rows start = step.starts();
  for (size_t p = 0; p < x.size(); ++p)
    if (step.is_held(p)) start[p] = x[p];
  float part = 1.0f;
  for (int halvings = 0; halvings <= 4; ++halvings, part *= 0.5f)
    if (falls_along(step, start, force, moved, newton, part)) return true;
  step.place(x, moved);
  return false;
}

// Returns whether the positions are a minimum of the energy and not a saddle. Conjugate gradients,
// preconditioned by sweeps, solve for a pseudorandom load. They may not meet a direction of
// negative curvature on their way. The loads of friction are constant, so that the forces have an
// energy.
template <class Step>
bool is_minimum(Step& step, size_t particles, int32_t sweeps) {
  constexpr double kSmall = 1e-3;     // the part of the load at which the search ends
  constexpr double kRounding = 1e-5;  // relative rounding of a curvature
  Rows load(particles);
  for (size_t p = 0; p < particles; ++p) {
    const auto scattered = [p](uint32_t axis) {
      uint32_t h = (static_cast<uint32_t>(p) * 3u + axis + 1u) * 0x9E3779B9u;
      h = (h ^ (h >> 15)) * 0x85EBCA6Bu;
      return static_cast<float>((h ^ (h >> 13)) >> 8) * 0x1p-23f - 1.0f;
    };
    if (!step.is_held(p)) load[p] = Vec3f{scattered(0), scattered(1), scattered(2)};
  }
  const double enough = kSmall * kSmall * inner(load, load);
  KeptDirections kept;  // its sizes are the curvatures
  step.keep_loads(true);
  bool curves_up = true;
  for (int32_t k = 0; k < sweeps && inner(load, load) > enough; ++k) {
    kept.make_room();
    Rows z(particles), image(particles);
    step.sweep(load, z, image);
    for (Row& row : image) row = -Vec3f(row);
    kept.take_from(z, image, kept.directions);
    const double curvature = inner(z, image);
    const double size = std::sqrt(inner(z, z) * inner(image, image));
    curves_up = curvature > -kRounding * size;
    if (!(curvature > kRounding * size)) break;
    const auto along = static_cast<float>(inner(load, z) / curvature);
    add_scaled(load, -along, image);
    kept.keep(std::move(z), std::move(image), curvature);
  }
  step.keep_loads(false);
  return curves_up;
}

struct Solution {
  VbdResidual residual;
  bool is_minimum = true;
};

// Solves the step until the relative residual is at most the tolerance or twice the rounding floor,
// or until `iterations` are over. Where the energy has negative curvature, Newton's method would
// lead to saddles and to other minima than the iterations do. Iterations of VBD then replace it.
// They also replace a step of Newton's method that fails.
template <class Step>
Solution solve_nonlinear(Step& step, double tolerance, int32_t iterations, int32_t sweeps) {
  constexpr int kIterationsInstead = 20;  // they cost less than a step of Newton's method
  VbdResidual now = step.residual();
  const auto is_solved = [tolerance](const VbdResidual& r) {
    return r.relative <= std::max(tolerance, 2.0 * r.floor);
  };
  const auto curves_up = [&] { return is_minimum(step, step.positions().size(), sweeps); };
  bool convex = false;
  for (int32_t k = 0; k < iterations && !is_solved(now); ++k) {
    convex = convex || curves_up();
    if (convex) {
      const Rows force = step.force();
      Rows load = force, newton;
      // tolerance of the linear systems: an inexact Newton method
      constexpr double kForcing = 1e-2;
      solve_linear(step, newton, load, kForcing, sweeps);
      convex = try_newton(step, force, newton);
    }
    for (int i = 0; !convex && i < kIterationsInstead; ++i) step.iterate_again();
    now = step.residual();
  }
  return {now, !is_solved(now) || curves_up()};
}

// Solves J^T solution = given until the true residual is small enough, because the residual of the
// recurrence drifts by rounding. step.reverse_sweep(r, z, left) runs a sweep in reverse for the
// load r: z are its multipliers, and left is what remains of r. step.balance(given, multipliers)
// returns what remains of `given`. step.balance also accumulates the derivatives for each input of
// f.
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
    // A sweep in reverse subtracts from r the image J^T z of the multipliers z that it finds.
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
