// Solves a step of VBD to convergence, and linear systems at its solution. Newton's method and a
// Krylov method use the sweeps of a step (StepTangent, StepAdjoint), which run on the model's
// device. The vectors here are on the host.
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

// What conjugate gradients found for J way = load, where the loads of friction are constant.
struct Descent {
  Rows way;               // the sum of the steps up to a direction of negative curvature
  Rows curves_down;       // this direction; without rows: none was met
  double residual = 1.0;  // what remains of the load, relative
};

// Runs conjugate gradients, preconditioned by sweeps. The energy falls along the way. Where the
// first direction has negative curvature, the way is this direction (Nocedal and Wright, Numerical
// Optimization, algorithm 7.1).
template <class Step>
Descent find_descent(Step& step, Rows load, double tolerance, int32_t sweeps) {
  constexpr double kRounding = 1e-5;  // relative rounding of a curvature
  const double scale = inner(load, load);
  Descent found;
  found.way.assign(load.size(), Row());
  KeptDirections kept;  // its sizes are the curvatures
  for (int32_t k = 0; k < sweeps && found.residual > tolerance; ++k) {
    kept.make_room();
    Rows z(load.size()), image(load.size());
    step.sweep(load, z, image);
    for (Row& row : image) row = -Vec3f(row);
    kept.take_from(z, image, kept.directions);
    const double curvature = inner(z, image), along = inner(load, z);
    const double size = std::sqrt(inner(z, z) * inner(image, image));
    if (!(curvature > kRounding * size)) {
      if (k == 0 && along > 0.0) found.way = z;
      if (curvature < -kRounding * size) found.curves_down = std::move(z);
      break;
    }
    const auto part = static_cast<float>(along / curvature);
    add_scaled(found.way, part, z);
    add_scaled(load, -part, image);
    found.residual = std::sqrt(inner(load, load) / scale);
    kept.keep(std::move(z), std::move(image), curvature);
  }
  return found;
}

// The places of the particles along a line from the present ones.
template <class Step>
struct Line {
  Step& step;
  const Rows x = step.positions(), moved = step.moves(), start = step.starts();

  // Kinematic particles stay where they are.
  void go(const Rows& way, float part) const {
    Rows to = x, now = moved;
    for (size_t p = 0; p < x.size(); ++p) {
      if (step.is_held(p)) continue;
      now[p] = Vec3f(moved[p]) + Vec3f(way[p]) * part;
      to[p] = Vec3f(start[p]) + Vec3f(now[p]);
    }
    step.place(to, now);
  }
  void go_back() const { step.place(x, moved); }
};

// Moves the particles along the way, and halves the step until the energy falls enough (Armijo).
// The loads of friction are constant. The change of the energy is the work of the forces along the
// step, by Simpson's rule, because rounding hides small changes of the energy. Returns the part of
// the way, or 0 with the old positions.
template <class Step>
float descend(Step& step, const Rows& way) {
  constexpr int kHalvings = 12;
  constexpr double kEnough = 1e-3, kOvershoot = 0.5;
  const double first = inner(step.force(), way);
  if (!(first >= 0.0)) return 0.0f;
  const Line<Step> line{step};
  const auto push_at = [&](float part) {
    line.go(way, part);
    return inner(step.force(), way);
  };
  float part = 1.0f;
  double end = push_at(part);
  for (int k = 0; k <= kHalvings; ++k, part *= 0.5f) {
    const double middle = push_at(0.5f * part);
    const double work = (first + 4.0 * middle + end) / 6.0;
    if (end > -kOvershoot * first && work > kEnough * first) {
      line.go(way, part);
      return part;
    }
    end = middle;
  }
  line.go_back();
  return 0.0f;
}

// A step of Newton's method with the whole derivative of the forces, friction included. Returns
// false, with the old positions, where it does not halve the force.
template <class Step>
bool refine(Step& step, const Rows& force, double tolerance, int32_t sweeps) {
  Rows load = force, newton;
  solve_linear(step, newton, load, tolerance, sweeps);
  const Line<Step> line{step};
  line.go(newton, 1.0f);
  const Rows left = step.force();
  const bool halves = inner(left, left) < 0.25 * inner(force, force);
  if (!halves) line.go_back();
  return halves;
}

// Returns a direction along which the energy has negative curvature. Without rows: conjugate
// gradients met none on their way to the solution for a pseudorandom load.
template <class Step>
Rows find_way_down(Step& step, int32_t sweeps) {
  constexpr double kSmall = 1e-3;  // the part of the load at which the search ends
  Rows load(step.positions().size());
  for (size_t p = 0; p < load.size(); ++p) {
    const auto scattered = [p](uint32_t axis) {
      uint32_t h = (static_cast<uint32_t>(p) * 3u + axis + 1u) * 0x9E3779B9u;
      h = (h ^ (h >> 15)) * 0x85EBCA6Bu;
      return static_cast<float>((h ^ (h >> 13)) >> 8) * 0x1p-23f - 1.0f;
    };
    if (!step.is_held(p)) load[p] = Vec3f{scattered(0), scattered(1), scattered(2)};
  }
  return find_descent(step, load, kSmall, sweeps).curves_down;
}

// Returns the direction, either way, that the forces push along. Its largest row is as long as the
// longest motion of the step, if particles moved.
template <class Step>
Rows way_off_saddle(Step& step, const Rows& down) {
  const auto longest = [](const Rows& rows) {
    float most = 0.0f;
    for (const Row& row : rows) most = std::max(most, math::length(Vec3f(row)));
    return most;
  };
  const float motion = longest(step.moves()), size = motion > 0.0f ? motion / longest(down) : 1.0f;
  Rows way(down.size());
  add_scaled(way, inner(step.force(), down) < 0.0 ? -size : size, down);
  return way;
}

struct Solution {
  VbdResidual residual;
  bool is_minimum = true;

  double allowed(double tolerance) const { return std::max(tolerance, 2.0 * residual.floor); }
  bool is_solved(double tolerance) const {
    return is_minimum && residual.relative <= allowed(tolerance);
  }
  // ErrorKind::Runtime: the step is not solved. `name` begins the message, and `advice` ends it.
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

// Solves the step until the relative residual is at most the tolerance or twice the rounding floor,
// or until `iterations` are over, by Newton's method on the energy.
// - An iteration keeps the loads of friction, so that the forces have an energy, and makes this
//   energy fall. After a whole step without negative curvature the next step uses the whole
//   derivative of the forces.
// - Iterations of VBD replace a step that fails. In the first half of the iterations they also
//   replace a step that meets negative curvature, because that step can lead to another minimum.
// - A saddle is left along its negative curvature.
template <class Step>
Solution solve_nonlinear(Step& step, double tolerance, int32_t iterations, int32_t sweeps) {
  constexpr int kIterationsInstead = 20;  // they cost less than a step of Newton's method
  constexpr double kForcing = 1e-2;  // tolerance of the linear systems: an inexact Newton method
  bool is_near = false;
  for (int32_t k = 0;; ++k) {
    Solution now = {step.residual()};
    const bool is_solved = now.is_solved(tolerance);
    if (!is_solved && k >= iterations) return now;
    Rows force = step.force();
    if (!is_solved && is_near && (is_near = refine(step, force, kForcing, sweeps))) continue;
    step.keep_loads(true);
    Rows way;
    if (is_solved) {
      const Rows down = find_way_down(step, sweeps);
      if (down.empty() || k >= iterations) {
        step.keep_loads(false);
        now.is_minimum = down.empty();
        return now;
      }
      way = way_off_saddle(step, down);
    } else {
      Descent found = find_descent(step, std::move(force), kForcing, sweeps);
      is_near = found.curves_down.empty();
      if (is_near || k >= iterations / 2) way = std::move(found.way);
    }
    const float part = way.empty() ? 0.0f : descend(step, way);
    step.keep_loads(false);
    is_near = is_near && part == 1.0f;
    for (int i = 0; part == 0.0f && i < kIterationsInstead; ++i) step.iterate_again();
  }
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
  const auto left = [&](const Rows& multipliers) {
    return residual = free_rows(step.balance(given, multipliers));
  };
  const auto more = [&](double asked, int32_t most) {
    // A sweep in reverse subtracts from r the image J^T z of the multipliers z that it finds.
    Rows part;
    const KrylovResult found =
        solve_krylov(part, residual, asked, most, [&](const Rows& r, Rows& z, Rows& image) {
          Rows remains;
          step.reverse_sweep(r, z, remains);
          image = r;
          add_scaled(image, -1.0f, free_rows(std::move(remains)));
        });
    add_scaled(solution, 1.0f, part);
    return found;
  };
  return refine_solution(solution, scale, tolerance, sweeps, more, left);
}

}  // namespace novaphy::vbd
