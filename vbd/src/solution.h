// Solves a step of VBD to convergence, and solves linear systems at its solution. Newton's method
// and a Krylov method use the sweeps of a step (StepTangent, StepAdjoint), which run on the model's
// device. The vectors in this file are on the host.
#pragma once

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "krylov.h"
#include "novaphy/core/error.h"
#include "novaphy/vbd/solver_vbd.h"
#include "rows.h"

namespace novaphy::vbd {

// Solves J solution = load, with J = -df/dx over the particles that move. step.sweep(r, z, image)
// sets z to the result of a sweep for the load r that starts from 0. It also sets image to the
// tangent of the forces along z.
template <class Step>
void solve_linear(Step& step, Rows& solution, Rows& load, const Numbers& tolerance, int32_t sweeps,
                  std::vector<KrylovResult>& results) {
  solve_krylov(step.components(), solution, load, tolerance, sweeps, results,
               [&](const Rows& r, Rows& z, Rows& image) {
                 step.sweep(r, z, image);
                 for (Row& row : image) row = -Vec3f(row);
               });
}

// The result of conjugate gradients for J way = load, with constant friction loads.
struct Descent {
  Rows way;           // sum of the steps before negative curvature
  Rows down;          // the direction of negative curvature
  Flags curves_down;  // whether a component has such a direction
};

// Runs conjugate gradients with sweeps as the preconditioner. The energy falls along `way`. If the
// first direction already has negative curvature, `way` is this direction (Nocedal and Wright,
// Numerical Optimization, algorithm 7.1).
template <class Step>
Descent find_descent(Step& step, Rows load, const Numbers& tolerance, int32_t sweeps) {
  constexpr double kRounding = 1e-5;  // relative rounding error of a curvature
  const Components of = step.components();
  const Numbers scale = of.inner(load, load);
  Descent found = {Rows(load.size()), Rows(load.size()), Flags(of.count)};
  Flags runs(of.count);
  for (size_t c = 0; c < of.count; ++c) runs[c] = scale[c] > 0.0;
  StoredDirections kept{of, {}, {}, {}};  // sizes: the curvatures
  for (int32_t k = 0; k < sweeps && any(runs); ++k) {
    kept.make_room();
    Rows z(load.size()), image(load.size());
    step.sweep(load, z, image);
    for (Row& row : image) row = -Vec3f(row);
    kept.take_from(z, image, kept.directions);
    Numbers curvature = of.inner(z, image), part(of.count), first(of.count);
    const Numbers along = of.inner(load, z), z2 = of.inner(z, z), image2 = of.inner(image, image);
    Flags down(of.count);
    for (size_t c = 0; c < of.count; ++c) {
      if (runs[c] == 0) continue;
      const double rounding = kRounding * std::sqrt(z2[c] * image2[c]);
      runs[c] = curvature[c] > rounding;
      if (runs[c] != 0) part[c] = along[c] / curvature[c];
      first[c] = runs[c] != 0 ? part[c] : k == 0 && along[c] > 0.0 ? 1.0 : 0.0;
      down[c] = curvature[c] < -rounding;
      found.curves_down[c] |= down[c];
    }
    of.add_scaled(found.way, first, z);
    of.add_scaled(found.down, down, z);
    of.add_scaled(load, part, image, -1.0f);
    const Numbers left = of.inner(load, load);
    for (size_t c = 0; c < of.count; ++c)
      runs[c] = runs[c] != 0 && std::sqrt(left[c] / scale[c]) > tolerance[c];
    kept.keep(std::move(z), std::move(image), std::move(curvature));
  }
  return found;
}

// A line from the current positions, along which components move.
template <class Step>
struct Line {
  Step& step;
  const Rows x = step.positions(), moved = step.moves(), start = step.starts();

  // Moves each component by its `part` of `way`. A component with part 0 stays in place, and so do
  // kinematic particles.
  template <class Part>
  void go(const Rows& way, const std::vector<Part>& part) const {
    Rows to = x, now = moved;
    step.components().visit([&](size_t p, size_t c) {
      if (part[c] == 0) return;
      now[p] = Vec3f(moved[p]) + Vec3f(way[p]) * static_cast<float>(part[c]);
      to[p] = Vec3f(start[p]) + Vec3f(now[p]);
    });
    step.place(to, now);
  }
  // Runs iterations of VBD for the components with a flag in `some`.
  void iterate(const Flags& some, int iterations) const {
    for (int i = 0; i < iterations; ++i) step.iterate_again();
    Rows to = step.positions(), now = step.moves();
    step.components().visit([&](size_t p, size_t c) {
      if (some[c] != 0) return;
      to[p] = x[p];
      now[p] = moved[p];
    });
    step.place(to, now);
  }
};

// Line search: moves the particles along `way`, and halves the step until the energy falls enough
// (Armijo condition). The friction loads are constant. The change of the energy is the work of the
// forces along the step by Simpson's rule, because rounding hides small changes of the energy.
// Returns the part of `way` that each component moved. A component that finds no step has part 0,
// and gets its old positions back.
template <class Step>
Numbers descend(Step& step, const Rows& way) {
  constexpr int kHalvings = 12;
  constexpr double kEnough = 1e-3, kOvershoot = 0.5;
  const Components of = step.components();
  const Numbers first = of.inner(step.force(), way), size = of.inner(way, way);
  const Line<Step> line{step};
  const auto push_at = [&](const Numbers& part) {
    line.go(way, part);
    return of.inner(step.force(), way);
  };
  Flags runs(of.count);
  for (size_t c = 0; c < of.count; ++c) runs[c] = first[c] >= 0.0 && size[c] > 0.0;
  Numbers part(runs.begin(), runs.end()), end = push_at(part);
  for (int k = 0; k <= kHalvings && any(runs); ++k) {
    Numbers half = part;
    for (size_t c = 0; c < of.count; ++c)
      if (runs[c] != 0) half[c] *= 0.5;
    const Numbers middle = push_at(half);
    for (size_t c = 0; c < of.count; ++c) {
      const double work = (first[c] + 4.0 * middle[c] + end[c]) / 6.0;
      if (end[c] > -kOvershoot * first[c] && work > kEnough * first[c]) runs[c] = 0;
      if (runs[c] == 0) continue;
      end[c] = middle[c];
      part[c] = k < kHalvings ? half[c] : 0.0;
    }
  }
  line.go(way, part);
  return part;
}

// Takes a step of Newton's method for the components with a flag in `some`, with the complete
// derivative of the forces, friction included. A component keeps the step if its force falls by
// half or more. Other components get their old positions back.
template <class Step>
void refine(Step& step, const Rows& force, Flags& some, double tolerance, int32_t sweeps) {
  const Components of = step.components();
  Rows load(force.size()), newton;
  of.add_scaled(load, some, force);
  std::vector<KrylovResult> results(of.count);
  solve_linear(step, newton, load, Numbers(of.count, tolerance), sweeps, results);
  const Line<Step> line{step};
  line.go(newton, some);
  const Rows left = step.force();
  const Numbers after = of.inner(left, left), before = of.inner(force, force);
  for (size_t c = 0; c < of.count; ++c) some[c] = some[c] != 0 && after[c] < 0.25 * before[c];
  line.go(newton, some);
}

// Returns a pseudorandom load. The load of a component does not depend on the other components.
inline Rows scattered_load(const Components& of) {
  Rows load(of.of.size());
  std::vector<uint32_t> next(of.count);
  of.visit([&](size_t p, size_t c) {
    const uint32_t number = next[c]++;
    const auto scattered = [number](uint32_t axis) {
      uint32_t h = (number * 3u + axis + 1u) * 0x9E3779B9u;
      h = (h ^ (h >> 15)) * 0x85EBCA6Bu;
      return static_cast<float>((h ^ (h >> 13)) >> 8) * 0x1p-23f - 1.0f;
    };
    load[p] = Vec3f{scattered(0), scattered(1), scattered(2)};
  });
  return load;
}

// Returns the direction `down` of each component with a flag in `some`, with the sign along which
// the forces push. A direction is scaled so that its longest row equals the longest displacement of
// the component's particles in the step. If no particle moved, `down` is not scaled.
template <class Step>
Rows way_off_saddle(Step& step, const Flags& some, const Rows& down) {
  const Components of = step.components();
  const auto longest = [&](const Rows& rows) {
    Numbers most(of.count);
    of.visit([&](size_t p, size_t c) {
      most[c] = std::max(most[c], static_cast<double>(math::length(Vec3f(rows[p]))));
    });
    return most;
  };
  const Numbers motion = longest(step.moves()), size = longest(down),
                push = of.inner(step.force(), down);
  Numbers part(of.count);
  for (size_t c = 0; c < of.count; ++c) {
    if (some[c] == 0) continue;
    part[c] = motion[c] > 0.0 ? motion[c] / size[c] : 1.0;
    if (push[c] < 0.0) part[c] = -part[c];
  }
  Rows way(down.size());
  of.add_scaled(way, part, down);
  return way;
}

struct Solution {
  VbdResidual residual;
  bool is_minimum = true;

  double allowed(double tolerance) const { return std::max(tolerance, 2.0 * residual.floor); }
  bool is_solved(double tolerance) const {
    return is_minimum && residual.relative <= allowed(tolerance);
  }
  // ErrorKind::Runtime: the step is not solved. The message begins with `name` and ends with
  // `advice`.
  void check(const char* name, double tolerance, int32_t iterations, const char* advice) const {
    require(is_minimum, ErrorKind::Runtime, name,
            ": the step was not solved: expected a minimum of its energy, got a saddle, where "
            "conjugate gradients met negative curvature; take shorter steps, or raise ",
            advice);
    require(is_solved(tolerance), ErrorKind::Runtime, name,
            ": the step was not solved: expected a relative residual of at most ",
            allowed(tolerance), ", got ", residual.relative, " after ", residual.iterations,
            " iterations and ", iterations, " of Newton's method; raise ", advice);
  }
};

// Solves the step by Newton's method on the energy. The iteration ends when the relative residual
// of each component is at most the tolerance or twice the rounding floor, or after `iterations`.
// - An iteration holds the friction loads constant, so that the forces have an energy, and makes
//   this energy fall. After a whole step without negative curvature the next step uses the complete
//   derivative of the forces (refine).
// - Iterations of VBD replace a step that fails. In the first half of the iterations, and at
//   most 15, they also replace a step that meets negative curvature, because that step can lead to
//   another minimum.
// - If the residual is small, conjugate gradients for a pseudorandom load search for negative
//   curvature. If they find a direction of negative curvature, the point is a saddle, and the step
//   leaves the saddle along this direction.
template <class Step>
Solution solve_nonlinear(Step& step, double tolerance, int32_t iterations, int32_t sweeps) {
  constexpr int kIterationsInstead = 20;  // cheaper than a step of Newton's method
  constexpr int kCareful = 15;            // most iterations without steps of negative curvature
  constexpr double kForcing = 1e-2;  // tolerance of the linear systems: an inexact Newton method
  constexpr double kSmall = 1e-3;    // the same, in the search for negative curvature
  const Components of = step.components();
  const size_t count = of.count;
  Flags runs(count, 1), is_near(count);
  bool is_minimum = true;
  for (int32_t k = 0;; ++k) {
    const Flags solved = step.solved(tolerance);
    for (size_t c = 0; c < count; ++c) runs[c] = runs[c] != 0 && (solved[c] != 0 || k < iterations);
    if (!any(runs)) return {step.residual(), is_minimum};
    const Rows force = step.force();
    Flags near(count), rest(count);
    for (size_t c = 0; c < count; ++c) near[c] = runs[c] != 0 && solved[c] == 0 && is_near[c] != 0;
    if (any(near)) refine(step, force, near, kForcing, sweeps);
    Rows load(force.size()), scattered = scattered_load(of);
    Numbers asked(count, kForcing);
    for (size_t c = 0; c < count; ++c) {
      rest[c] = runs[c] != 0 && near[c] == 0;
      if (solved[c] != 0) asked[c] = kSmall;
    }
    if (!any(rest)) continue;
    of.visit([&](size_t p, size_t c) {
      if (rest[c] != 0) load[p] = solved[c] != 0 ? scattered[p] : force[p];
    });
    step.keep_loads(true);
    const Descent found = find_descent(step, std::move(load), asked, sweeps);
    Flags saddle(count), goes(count);
    for (size_t c = 0; c < count; ++c) {
      if (rest[c] == 0) continue;
      const bool curves_down = found.curves_down[c] != 0;
      saddle[c] = solved[c] != 0 && curves_down && k < iterations;
      if (solved[c] != 0) {
        is_minimum = is_minimum && !(curves_down && k >= iterations);
        runs[c] = rest[c] = saddle[c];
      } else {
        is_near[c] = !curves_down;
        goes[c] = !curves_down || k >= std::min(iterations / 2, kCareful);
      }
    }
    Rows way = way_off_saddle(step, saddle, found.down);
    of.add_scaled(way, goes, found.way);
    const Numbers part = descend(step, way);
    step.keep_loads(false);
    for (size_t c = 0; c < count; ++c) {
      is_near[c] = is_near[c] != 0 && (rest[c] == 0 || part[c] == 1.0);
      rest[c] = rest[c] != 0 && part[c] == 0.0;
    }
    if (any(rest)) Line<Step>{step}.iterate(rest, kIterationsInstead);
  }
}

// Solves J^T solution = given, until the true residual is small enough. The residual of the
// recurrence is not sufficient, because it drifts by rounding. step.reverse_sweep(r, z, left) runs
// a sweep in reverse for the load r: z are the multipliers, and left is r - J^T z.
// step.balance(given, multipliers) returns given - J^T multipliers. It also accumulates the
// derivatives with respect to each input of f.
template <class Step>
KrylovResult solve_transposed(Step& step, const Rows& given, double tolerance, int32_t sweeps) {
  const Components of = step.components();
  const auto free_rows = [&of](const Rows& rows) {
    Rows all(rows.size());
    of.add_scaled(all, Flags(of.count, 1), rows);
    return all;
  };
  const Rows load = free_rows(given);
  Rows residual = load, solution(given.size());
  const auto left = [&](const Rows& multipliers) {
    return residual = free_rows(step.balance(given, multipliers));
  };
  const auto more = [&](const Numbers& asked, std::vector<KrylovResult>& results) {
    // A reverse sweep subtracts from r the image J^T z of the multipliers z.
    Rows part;
    solve_krylov(of, part, residual, asked, sweeps, results,
                 [&](const Rows& r, Rows& z, Rows& image) {
                   Rows remains;
                   step.reverse_sweep(r, z, remains);
                   image = r;
                   of.add_scaled(image, Flags(of.count, 1), remains, -1.0f);
                 });
    of.add_scaled(solution, Flags(of.count, 1), part);
  };
  return refine_solution(of, solution, load, tolerance, sweeps, more, left);
}

}  // namespace novaphy::vbd
