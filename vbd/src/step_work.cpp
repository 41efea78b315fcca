#include "step_work.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "novaphy/core/error.h"
#include "novaphy/core/parallel.h"

namespace novaphy::vbd {
namespace {

constexpr const char* kName = "SolverVBD.step";
constexpr int64_t kParticlesPerChunk = 512;
constexpr int64_t kLanesPerChunk = 64;  // particles of a colour that one thread takes at a time

float* floats(std::vector<Row>& rows) { return reinterpret_cast<float*>(rows.data()); }

// Numbers of the model that this solver has no use for.
void check_numbers(const Model& model) {
  model.check_numbers(kName);
  require(model.particle_adhesion == 0.0f, ErrorKind::NotImplemented, kName,
          ": model.particle_adhesion: not there yet, expected 0, got ", model.particle_adhesion);
  require(model.particle_max_velocity >= ModelNumbers{}.particle_max_velocity,
          ErrorKind::NotImplemented, kName,
          ": model.particle_max_velocity: not there yet, expected the default, got ",
          model.particle_max_velocity);
}

// Chebyshev's factors: 1, 2/(2 - rho^2), then 4/(4 - rho^2 omega).
std::vector<float> chebyshev_factors(float radius, int32_t iterations) {
  const double rho2 = static_cast<double>(radius) * static_cast<double>(radius);
  std::vector<float> factors;
  double omega = 1.0;
  for (int32_t k = 0; k <= iterations; ++k) {
    if (k >= 2) omega = k == 2 ? 2.0 / (2.0 - rho2) : 4.0 / (4.0 - rho2 * omega);
    factors.push_back(static_cast<float>(omega));
  }
  return factors;
}

// The part of gravity, 0 to 1, in the acceleration of the step before.
float gravity_that_acted(const Vec3f& g, const Vec3f& acceleration) {
  const float squared = math::dot(g, g);
  return squared > 0.0f ? math::clamp(math::dot(acceleration, g) / squared, 0.0f, 1.0f) : 0.0f;
}

}  // namespace

StepWork::StepWork(const Model& m, const VbdOptions& o, bool keep_iterates) : model(m), options(o) {
  materials_.check(m);
  for (const auto& [name, array] : std::initializer_list<std::pair<const char*, const Array*>>{
           {"particle_colors", &m.particle_colors},
           {"particle_spring_indices", &m.particle_spring_indices},
           {"particle_tri_indices", &m.particle_tri_indices},
           {"particle_edge_indices", &m.particle_edge_indices},
           {"particle_tet_indices", &m.particle_tet_indices}})
    mesh_.emplace_back(name, array);
  for (const Array* array : std::initializer_list<const Array*>{
           &m.particle_flags, &m.particle_mass, &m.particle_inv_mass, &m.particle_spring_stiffness,
           &m.particle_spring_damping, &m.particle_spring_rest_length, &m.particle_tri_pose,
           &m.particle_tri_area, &m.particle_tri_material, &m.particle_edge_rest_angle,
           &m.particle_edge_rest_length, &m.particle_edge_material, &m.particle_tet_pose,
           &m.particle_tet_material})
    values_.emplace_back("", array);
  const auto n = static_cast<size_t>(m.particle_count());
  for (std::vector<Row>* rows : {&start, &target, &moved, &x}) rows->resize(n);
  if (keep_iterates) iterates.assign(static_cast<size_t>(o.iterations) + 1, std::vector<Row>(n));
  if (o.acceleration) {
    newer_.resize(n);
    older_.resize(n);
    chebyshev_ = chebyshev_factors(*o.acceleration, o.iterations);
  }
  build();
  for (Stamped& s : mesh_) s.stamp.set(*s.array);
}

void StepWork::build() {
  slots.build(model, level.lanes);
  ++builds;
  if (slots.has_conflicts()) next_.resize(x.size());
  plan();
  for (Stamped& s : values_) s.stamp.set(*s.array);
  constants = {};
}

// All chunks of a step, and where its phases end.
void StepWork::plan() {
  chunks_.clear();
  ends_.clear();
  const auto phase = [&](Task task, int32_t iteration, int64_t begin, int64_t end, int64_t size) {
    if (begin == end) return;
    for (int64_t first = begin; first < end; first += size)
      chunks_.push_back({task, iteration, first, std::min(first + size, end)});
    ends_.push_back(static_cast<int64_t>(chunks_.size()));
  };
  const auto n = static_cast<int64_t>(x.size());
  const std::vector<int64_t>& colors = slots.color_begin();
  const int64_t groups_per_chunk = kLanesPerChunk / level.lanes;
  phase(Task::Predict, 0, 0, n, kParticlesPerChunk);
  phase(Task::Prepare, 0, 0, colors.back(), groups_per_chunk);
  iteration_ends_.assign(1, ends_.size());
  for (int32_t k = 1; k <= options.iterations; ++k) {
    if (!iterates.empty()) phase(Task::Keep, k - 1, 0, n, kParticlesPerChunk);
    for (size_t c = 0; c + 1 < colors.size(); ++c) {
      phase(Task::Move, k, colors[c], colors[c + 1], groups_per_chunk);
      if (slots.has_conflicts()) phase(Task::Commit, k, colors[c], colors[c + 1], groups_per_chunk);
    }
    if (options.acceleration) phase(Task::Accelerate, k, 0, n, kParticlesPerChunk);
    iteration_ends_.push_back(ends_.size());
  }
  if (!iterates.empty()) phase(Task::Keep, options.iterations, 0, n, kParticlesPerChunk);
  phase(Task::Finish, 0, 0, n, kParticlesPerChunk);
}

void StepWork::update(const DeviceArray<float>* tri_activation,
                      const DeviceArray<float>* tet_activation, const Contacts* contact_rows,
                      float step_dt) {
  materials_.check(model);
  check_numbers(model);
  for (const Stamped& s : mesh_)
    require(s.stamp.matches(*s.array), ErrorKind::Value, kName, ": model.", s.name,
            ": it was edited after the solver was made; make a new one");
  if (std::any_of(values_.begin(), values_.end(),
                  [](const Stamped& s) { return !s.stamp.matches(*s.array); }))
    build();
  const auto& tri = tri_activation != nullptr ? *tri_activation : model.particle_tri_activation;
  const auto& tet = tet_activation != nullptr ? *tet_activation : model.particle_tet_activation;
  if (constants.dt != step_dt || !activation_[0].matches(tri) || !activation_[1].matches(tet)) {
    constants = {tri.data(), tet.data(), step_dt};
    slots.set_constants(model, constants);
    activation_[0].set(tri);
    activation_[1].set(tet);
  }
  contacts.update(model, contact_rows, step_dt);
  if (!world_.matches(model.particle_world)) {
    for (int32_t p = 0; p < model.particle_count(); ++p) {
      const int32_t w = model.particle_world.data()[p];
      require(w >= -1 && w < model.world_count(), ErrorKind::Index, kName,
              ": model.particle_world[", p, "]: expected -1 to ", model.world_count() - 1, ", got ",
              w);
    }
    world_.set(model.particle_world);
  }

  slots.fill(sweep);
  contacts.fill(sweep);
  sweep.start = floats(start);
  sweep.target = floats(target);
  sweep.moved = floats(moved);
  sweep.x = floats(x);
  sweep.step = slots.has_conflicts() ? floats(next_) : nullptr;
  sweep.regularization = options.lhs_regularization;
  sweep.slip = options.friction_epsilon * step_dt;
  sweep.safeguard = options.safeguard;
}

void StepWork::run(const StepArrays& step_arrays, const Vec3f* targets) {
  arrays_ = step_arrays;
  const size_t first = iteration_ends_.front(), last = iteration_ends_.back();
  run_phases(0, first);
  if (targets != nullptr)
    for (const int32_t held : slots.held()) x[static_cast<size_t>(held)] = *targets++;
  if (options.tolerance) {
    iterate();
  } else {
    run_phases(first, last);
    iterations_run_ = options.iterations;
  }
  run_phases(last, ends_.size());
  if (options.initial_guess == VbdInitialGuess::Adaptive) {
    last_velocity.assign(arrays_.qd, arrays_.qd + x.size());
    has_last = true;
  }
  has_stepped = true;
}

void StepWork::iterate_again() {
  const size_t last = iteration_ends_.size() - 1;
  run_phases(iteration_ends_[last - 1], iteration_ends_[last]);
  ++iterations_run_;
}

void StepWork::finish_again() { run_phases(iteration_ends_.back(), ends_.size()); }

// Until the residual is small enough.
void StepWork::iterate() {
  for (iterations_run_ = 0; iterations_run_ < options.iterations;) {
    ++iterations_run_;
    const auto k = static_cast<size_t>(iterations_run_);
    run_phases(iteration_ends_[k - 1], iteration_ends_[k]);
    if (residual().relative <= static_cast<double>(*options.tolerance)) return;
  }
}

void StepWork::run_phases(size_t first, size_t last) {
  const int64_t begin = first == 0 ? 0 : ends_[first - 1];
  parallel_phases(
      begin, std::span<const int64_t>(ends_).subspan(first, last - first),
      [](void* pointer, int64_t chunk) {
        auto* const work = static_cast<StepWork*>(pointer);
        work->run_chunk(work->chunks_[static_cast<size_t>(chunk)]);
      },
      this);
}

void StepWork::run_chunk(const Chunk& chunk) {
  switch (chunk.task) {
    case Task::Predict:
      return predict(chunk.begin, chunk.end);
    case Task::Prepare:
      for (int64_t group = chunk.begin; group < chunk.end; ++group) level.prepare(sweep, group);
      return;
    case Task::Move:
      for (int64_t group = chunk.begin; group < chunk.end; ++group) level.move(sweep, group);
      return;
    case Task::Commit:
      for (int64_t k = chunk.begin * level.lanes; k < chunk.end * level.lanes; ++k) {
        const auto p = static_cast<size_t>(sweep.particle[k]);
        x[p] = next_[p];
      }
      return;
    case Task::Accelerate:
      return accelerate(chunk);
    case Task::Keep:
      std::copy(x.begin() + chunk.begin, x.begin() + chunk.end,
                iterates[static_cast<size_t>(chunk.iteration)].begin() + chunk.begin);
      return;
    case Task::Finish:
      return finish(chunk.begin, chunk.end);
  }
}

void StepWork::predict(int64_t begin, int64_t end) {
  const auto [q, qd, f, q_out, qd_out] = arrays_;
  const float* inv_mass = model.particle_inv_mass.data();
  const int32_t* worlds = model.particle_world.data();
  const int32_t last_world = model.world_count() - 1;
  const float h = constants.dt;
  for (int64_t i = begin; i < end; ++i) {
    const auto p = static_cast<size_t>(i);
    start[p] = q[p];
    if (slots.is_held(static_cast<int32_t>(p))) {
      x[p] = target[p] = q[p];
      moved[p] = Row();
      continue;
    }
    const Vec3f& g = model.gravity.data()[worlds[p] < 0 ? last_world : worlds[p]];
    const Vec3f travel = (qd[p] + (g + f[p] * inv_mass[p]) * h) * h;
    target[p] = q[p] + travel;
    Vec3f guess = travel;
    if (options.initial_guess == VbdInitialGuess::Previous) guess = Vec3f{};
    if (options.initial_guess == VbdInitialGuess::Adaptive && has_last)
      guess = qd[p] * h + (g * gravity_that_acted(g, (qd[p] - last_velocity[p]) / h)) * (h * h);
    moved[p] = guess;
    x[p] = q[p] + guess;
    if (options.acceleration) newer_[p] = moved[p];
  }
}

void StepWork::accelerate(const Chunk& chunk) {
  const float omega = chebyshev_[static_cast<size_t>(chunk.iteration)];
  for (int64_t i = chunk.begin; i < chunk.end; ++i) {
    const auto p = static_cast<size_t>(i);
    const auto particle = static_cast<int32_t>(i);
    if (chunk.iteration > 1 && !slots.is_held(particle) && !contacts.touches(particle)) {
      const Vec3f before = older_[p];
      moved[p] = (Vec3f(moved[p]) - before) * omega + before;
      x[p] = Vec3f(start[p]) + Vec3f(moved[p]);
    }
    older_[p] = newer_[p];
    newer_[p] = moved[p];
  }
}

void StepWork::finish(int64_t begin, int64_t end) {
  for (int64_t i = begin; i < end; ++i) {
    const auto p = static_cast<size_t>(i);
    arrays_.q_out[p] = x[p];
    arrays_.qd_out[p] = (Vec3f(x[p]) - Vec3f(start[p])) / constants.dt;
  }
}

VbdResidual StepWork::residual() {
  of_particles_.assign(x.size(), {});
  for (int64_t group = 0; group < slots.color_begin().back(); ++group)
    level.residual(sweep, group, of_particles_.data());
  double force = 0.0, inertia = 0.0, rounding = 0.0;
  for (const ParticleResidual& r : of_particles_) {
    force += static_cast<double>(r.force);
    inertia += static_cast<double>(r.inertia);
    rounding += static_cast<double>(r.rounding);
  }
  const auto relative = [inertia](double squared) {
    return squared > 0.0 ? std::sqrt(squared / inertia) : 0.0;
  };
  return {std::sqrt(force), std::sqrt(inertia), relative(force), relative(rounding),
          iterations_run_};
}

}  // namespace novaphy::vbd
