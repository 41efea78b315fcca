// How far a step of VBD is from its solution.
#include <cmath>

#include "step.h"
#include "step_options.h"

namespace novaphy::vbd {

void Step::find_residuals() {
  const int64_t groups = colors().back();
  novaphy::run(kernels().clear, static_cast<int64_t>(of_particles_.rows()),
               {.values = of_particles_});
  VbdSweepArguments all = sweep(0, groups);
  all.turns = 0;
  novaphy::run(kernels().residual, groups * slots_.lanes(), all);
}

// Returns the sum of |m (y - xn - h vc)/h^2|^2 over the particles that move (N^2), where vc is the
// mean velocity of the particle's component. A force that is the same for a whole component, except
// gravity, counts as a velocity.
double Step::motion_scale() const {
  using Point = Vec3<double>;
  const auto wide = [](const Vec3f& v) {
    return Point{static_cast<double>(v.x), static_cast<double>(v.y), static_cast<double>(v.z)};
  };
  auto& [start, target, gravities, moments, masses] = motion_;
  start.resize(start_.rows());
  target.resize(start.size());
  gravities.resize(model_.gravity.rows());
  start_.Array::copy_to_host(start.data(), start_.bytes());
  target_.Array::copy_to_host(target.data(), target_.bytes());
  model_.gravity.copy_to_host(std::span(gravities));
  moments.assign(start.size(), Point{});
  masses.assign(start.size(), 0.0);
  // Calls body(mass, y - xn, h^2 g, component) for each particle that moves.
  const auto for_moving = [&](const auto& body) {
    const double h2 = static_cast<double>(dt()) * static_cast<double>(dt());
    for (size_t p = 0; p < start.size(); ++p) {
      if (is_held(p)) continue;
      const int32_t world = host_model().particle_world.data()[p];
      const Vec3f& g = world < 0 ? gravities.back() : gravities[static_cast<size_t>(world)];
      body(static_cast<double>(host_model().particle_mass.data()[p]),
           wide(Vec3f(target[p]) - Vec3f(start[p])), wide(g) * h2,
           static_cast<size_t>(slots_.components()[p]));
    }
  };
  for_moving([&](double mass, const Point& travel, const Point&, size_t of) {
    moments[of] = moments[of] + travel * mass;
    masses[of] += mass;
  });
  double sum = 0.0;
  for_moving([&](double mass, const Point& travel, const Point& fall, size_t of) {
    const Point force = (travel - moments[of] / masses[of] + fall) * mass;
    sum += math::dot(force, force);
  });
  return sum / std::pow(static_cast<double>(dt()), 4);
}

VbdResidual Step::sum_residuals(double motion) const {
  of_particles_.copy_to_host(std::span(&residuals_.data()->force, of_particles_.rows()));
  return vbd::sum_residuals(residuals_, motion, iterations_run_);
}

VbdResidual Step::last_residual() const { return sum_residuals(motion_scale()); }

VbdResidual Step::residual() {
  find_residuals();
  return last_residual();
}

}  // namespace novaphy::vbd
