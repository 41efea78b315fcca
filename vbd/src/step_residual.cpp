// The residual of a step of VBD: how far the step is from its solution.
#include <algorithm>
#include <cmath>

#include "step.h"

namespace novaphy::vbd {

void Step::find_residuals() {
  const int64_t groups = colors().back();
  novaphy::run(kernels().clear, static_cast<int64_t>(of_particles_.rows()),
               {.values = of_particles_});
  VbdSweepArguments all = sweep(0, groups);
  all.turns = 0;
  novaphy::run(kernels().residual, groups * slots_.lanes(), all);
}

// Computes the sum of |m (y - xn - h vc)/h^2|^2 over the particles of each component (N^2), where
// vc is the mean velocity of the component. A force that accelerates all particles of a component
// equally counts as a part of vc. Gravity does not.
void Step::find_motion() const {
  using Point = Vec3<double>;
  const auto wide = [](const Vec3f& v) {
    return Point{static_cast<double>(v.x), static_cast<double>(v.y), static_cast<double>(v.z)};
  };
  auto& [start, target, gravities, moments, masses, squares] = motion_;
  start.resize(start_.rows());
  target.resize(start.size());
  gravities.resize(model_.gravity.rows());
  start_.Array::copy_to_host(start.data(), start_.bytes());
  target_.Array::copy_to_host(target.data(), target_.bytes());
  model_.gravity.copy_to_host(std::span(gravities));
  const Components of = components();
  moments.assign(of.count, Point{});
  masses.assign(of.count, 0.0);
  squares.assign(of.count, 0.0);
  const double h2 = static_cast<double>(dt()) * static_cast<double>(dt());
  const auto mass = [this](size_t p) {
    return static_cast<double>(host_model().particle_mass.data()[p]);
  };
  const auto travel = [&](size_t p) { return wide(Vec3f(target[p]) - Vec3f(start[p])); };
  of.visit([&](size_t p, size_t c) {
    moments[c] = moments[c] + travel(p) * mass(p);
    masses[c] += mass(p);
  });
  of.visit([&](size_t p, size_t c) {
    const int32_t world = host_model().particle_world.data()[p];
    const Vec3f& g = world < 0 ? gravities.back() : gravities[static_cast<size_t>(world)];
    const Point force = (travel(p) - moments[c] / masses[c] + wide(g) * h2) * mass(p);
    squares[c] += math::dot(force, force);
  });
  for (double& square : squares) square /= std::pow(static_cast<double>(dt()), 4);
}

// Sums the squares that find_residuals computed, in double precision, in the order of the
// particles.
void Step::sum_residuals() const {
  of_particles_.copy_to_host(std::span(&residuals_.data()->force, of_particles_.rows()));
  const Components of = components();
  sums_.resize(of.count);
  for (size_t c = 0; c < of.count; ++c) sums_[c] = {0.0, motion_.squares[c], 0.0};
  of.visit([this](size_t p, size_t c) {
    sums_[c].force += static_cast<double>(residuals_[p].force);
    sums_[c].scale += static_cast<double>(residuals_[p].parts);
    sums_[c].rounding += static_cast<double>(residuals_[p].rounding);
  });
}

// Returns the residual of the worst component. If the force of a component exceeds two roundings,
// only such components count. The worst component has the largest ratio of force to scale.
VbdResidual Step::last_residual() const {
  find_motion();
  sum_residuals();
  VbdResidual worst;
  bool is_above = false;
  for (const Sums& s : sums_) {
    const bool above = !(s.force <= 4.0 * s.rounding);
    const double relative = s.force == 0.0 ? 0.0 : std::sqrt(s.force / s.scale);
    if (above < is_above || (above == is_above && relative < worst.relative)) continue;
    is_above = above;
    const double floor = s.rounding == 0.0 ? 0.0 : std::sqrt(s.rounding / s.scale);
    worst = {std::sqrt(s.force), std::sqrt(s.scale), relative, floor, 0};
    if (std::isnan(relative)) break;
  }
  worst.iterations = iterations_run_;
  return worst;
}

VbdResidual Step::residual() {
  find_residuals();
  return last_residual();
}

Flags Step::solved(double tolerance) {
  find_residuals();
  find_motion();
  sum_residuals();
  Flags solved;
  for (const Sums& s : sums_)
    solved.push_back(s.force <= std::max(tolerance * tolerance * s.scale, 4.0 * s.rounding));
  return solved;
}

// Runs iterations until the residual of each component is within the tolerance. When a component
// reaches the tolerance, its positions no longer change.
void Step::iterate_to(double tolerance, const StepList& list) {
  const Components of = components();
  find_motion();  // constant during the iterations
  ended_.assign(of.count, 0);
  ended_x_.resize(x_.rows());
  ended_moved_.resize(x_.rows());
  Vec4f *const x = x_.mutable_data(), *const moved = moved_.mutable_data();
  for (iterations_run_ = 0; iterations_run_ < options_.iterations;) {
    ++iterations_run_;
    const auto k = static_cast<size_t>(iterations_run_);
    list.iterate(k - 1, k);
    of.visit([&](size_t p, size_t c) {
      if (ended_[c] == 0) {
        ended_x_[p] = x[p];
        ended_moved_[p] = moved[p];
      } else {
        x[p] = ended_x_[p];
        moved[p] = ended_moved_[p];
      }
    });
    find_residuals();
    sum_residuals();
    bool all = true;
    for (size_t c = 0; c < of.count; ++c) {
      ended_[c] |= sums_[c].force <= tolerance * tolerance * sums_[c].scale;
      all = all && ended_[c] != 0;
    }
    if (all) return;
  }
}

}  // namespace novaphy::vbd
