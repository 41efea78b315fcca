#include "tangent_pass.h"

#include <algorithm>
#include <cmath>

#include "novaphy/core/sim/for_chunks.h"

namespace novaphy::vbd {
namespace {

constexpr int64_t kGroupsPerChunk = 8;

}  // namespace

template <class Function>
void TangentPass::for_groups(size_t first_color, size_t last_color, Function&& function) {
  const std::vector<int64_t>& colors = step.slots.color_begin();
  const int64_t begin = colors[first_color], end = colors[last_color];
  for_chunks(end - begin, kGroupsPerChunk, [&](int64_t first, int64_t last, int64_t) {
    for (int64_t g = begin + first; g < begin + last; ++g) function(step.sweep, tangents_, g);
  });
}

template <class Function>
void TangentPass::for_particles(size_t color, Function&& function) {
  const std::vector<int64_t>& colors = step.slots.color_begin();
  const auto lanes = static_cast<int64_t>(step.level.lanes);
  for (int64_t g = colors[color]; g < colors[color + 1]; ++g)
    for (int64_t l = 0; l < step.sweep.filled[g]; ++l)
      function(static_cast<size_t>(step.sweep.particle[g * lanes + l]));
}

void TangentPass::prepare() {
  const size_t n = step.x.size();
  for (Rows* rows : {&x_slope, &start_slope, &target_slope, &guess_slope}) rows->assign(n, {});
  mass_slope.assign(n, 0.0f);
  contact_slopes.assign(step.contacts.count() * kContactLawFloats, 0.0f);
  tangents_ = {};
  for (int role = 0; role < kRoles; ++role) {
    const size_t lanes = step.slots.table(static_cast<Role>(role)).sources.size();
    number_slopes[role].assign(lanes * static_cast<size_t>(kFloats[role]), 0.0f);
    tangents_.numbers[role] = number_slopes[role].data();
  }
  tangents_.x = floats(x_slope);
  tangents_.start = floats(start_slope);
  tangents_.target = floats(target_slope);
  tangents_.mass_by_h2 = mass_slope.data();
  tangents_.contacts = contact_slopes.data();
}

void TangentPass::tangent_start() {
  for_groups(0, step.slots.color_begin().size() - 1, step.level.tangent_start);
}

void TangentPass::unrolled() {
  tangent_start();
  for (size_t p = 0; p < x_slope.size(); ++p)
    if (!is_held(p)) x_slope[p] = guess_slope[p];
  Rows moved(x_slope.size());
  tangents_.step_slope = floats(moved);
  step.x = step.iterates.front();
  const size_t colors = step.slots.color_begin().size() - 1;
  for (size_t k = 0; k + 1 < step.iterates.size(); ++k)
    for (size_t color = 0; color < colors; ++color) {
      for_groups(color, color + 1, step.level.tangent);
      for_particles(color, [&](size_t p) {
        x_slope[p] = Vec3f(x_slope[p]) + Vec3f(moved[p]);
        step.x[p] = step.iterates[k + 1][p];
      });
    }
  tangents_.step_slope = nullptr;
}

// A sweep from 0 with the load, at a solution, and the derivative of the forces along it.
void TangentPass::sweep(const Rows& load, Rows& z, Rows& image) {
  const Tangents kept = tangents_;
  tangents_ = {};
  tangents_.at_rest = true;
  tangents_.keeps_loads = kept.keeps_loads;
  const size_t colors = step.slots.color_begin().size() - 1;
  Rows moved(load.size());
  tangents_.x = floats(z);
  tangents_.load = reinterpret_cast<const float*>(load.data());
  tangents_.step_slope = floats(moved);
  for (size_t color = 0; color < colors; ++color) {
    for_groups(color, color + 1, step.level.tangent);
    for_particles(color, [&](size_t p) { z[p] = Vec3f(z[p]) + Vec3f(moved[p]); });
  }
  tangents_.step_slope = nullptr;
  tangents_.force_slope = floats(image);
  for_groups(0, colors, step.level.tangent);
  tangents_ = kept;
}

KrylovResult TangentPass::implicit(double tolerance, int32_t sweeps) {
  tangent_start();
  const size_t colors = step.slots.color_begin().size() - 1;
  // The derivative of the force: with the particles that move at rest the load, then what is left
  // of it.
  const auto force_slope = [&] {
    Rows force(x_slope.size());
    tangents_.force_slope = floats(force);
    for_groups(0, colors, step.level.tangent);
    tangents_.force_slope = nullptr;
    return force;
  };
  tangents_.at_rest = true;
  Rows load = force_slope();
  const double scale = std::sqrt(inner(load, load));
  KrylovResult result;
  for (int round = 0; round < kRefinements; ++round) {
    Rows more;
    const double asked = kMargin * tolerance * (round > 0 ? 1.0 / result.residual : 1.0);
    result.iterations +=
        solve_linear(*this, more, load, asked, sweeps - result.iterations).iterations;
    for (size_t p = 0; p < x_slope.size(); ++p)
      if (!is_held(p)) x_slope[p] = Vec3f(x_slope[p]) + Vec3f(more[p]);
    load = force_slope();
    result.residual = scale == 0.0 ? 0.0 : std::sqrt(inner(load, load)) / scale;
    if (result.residual <= tolerance || result.iterations >= sweeps) break;
  }
  return result;
}

Rows TangentPass::force() {
  Rows force(step.x.size());
  tangents_.force = floats(force);
  for_groups(0, step.slots.color_begin().size() - 1, step.level.tangent);
  tangents_.force = nullptr;
  return force;
}

Solution TangentPass::solve_step(double tolerance, int32_t iterations, int32_t sweeps) {
  tangents_ = {};
  const Solution found = solve_nonlinear(*this, tolerance, iterations, sweeps);
  step.finish_again();
  return found;
}

}  // namespace novaphy::vbd
