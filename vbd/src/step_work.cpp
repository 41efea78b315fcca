#include "step_work.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "novaphy/core/error.h"
#include "novaphy/core/parallel.h"
#include "novaphy/vbd/particle_step_trace.h"
#include "step_options.h"

namespace novaphy::vbd {
namespace {

constexpr const char* kName = "SolverVBD.step";
constexpr int64_t kParticlesPerChunk = 512;
constexpr int64_t kLanesPerChunk = 64;  // particles of a colour that one thread takes at a time

float* floats(std::vector<Row>& rows) { return reinterpret_cast<float*>(rows.data()); }

}  // namespace

StepWork::StepWork(const Model& m, const VbdOptions& o, bool keep_iterates) : model(m), options(o) {
  materials_.check(m);
  edited_.check(m);
  for (const auto& [name, array] : std::initializer_list<std::pair<const char*, const Array*>>{
           {"particle_colors", &m.particle_colors},
           {"particle_spring_indices", &m.particle_spring_indices},
           {"particle_tri_indices", &m.particle_tri_indices},
           {"particle_edge_indices", &m.particle_edge_indices},
           {"particle_tet_indices", &m.particle_tet_indices}})
    mesh_.emplace_back(name, array);
  for (const Array* array : std::initializer_list<const Array*>{
           &m.particle_flags, &m.particle_mass, &m.particle_inv_mass, &m.particle_spring_stiffness,
           &m.particle_spring_damping, &m.particle_spring_control, &m.particle_spring_rest_length,
           &m.particle_tri_pose, &m.particle_tri_area, &m.particle_tri_material,
           &m.particle_edge_rest_angle, &m.particle_edge_rest_length, &m.particle_edge_material,
           &m.particle_tet_pose, &m.particle_tet_material})
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
  edited_.check(model);
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
    for (const auto& [name, array] :
         {std::pair("particle_tri_activation", &tri), std::pair("particle_tet_activation", &tet)})
      for (size_t e = 0; e < array->rows(); ++e)
        require(std::isfinite(array->data()[e]), ErrorKind::Value, kName, ": ", name, "[", e,
                "]: expected a finite number, got ", array->data()[e]);
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
  if (damps)
    for (SlotTable& table : sweep.slots) table.damped = true;
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
  has_bad_inputs_ = false;
  run_phases(0, first);
  if (has_bad_inputs_) check_inputs();
  if (targets != nullptr)
    for (const int32_t held : slots.held()) x[static_cast<size_t>(held)] = *targets++;
  if (options.tolerance) {
    iterate();
  } else {
    run_phases(first, last);
    iterations_run_ = options.iterations;
  }
  check_positions();
  run_phases(last, ends_.size());
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
  const auto [q, qd, f, q_out, qd_out, last] = arrays_;
  const float* inv_mass = model.particle_inv_mass.data();
  const int32_t* worlds = model.particle_world.data();
  const int32_t last_world = model.world_count() - 1;
  const float h = constants.dt;
  bool good = true;
  for (int64_t i = begin; i < end; ++i) {
    const auto p = static_cast<size_t>(i);
    start[p] = q[p];
    good &= is_finite(q[p]);
    if (slots.is_held(static_cast<int32_t>(p))) {
      x[p] = target[p] = q[p];
      moved[p] = Row();
      continue;
    }
    const Vec3f& g = model.gravity.data()[worlds[p] < 0 ? last_world : worlds[p]];
    const Vec4f before = last != nullptr ? last[p] : Vec4f{};
    const Prediction prediction = predict_particle(
        q[p], qd[p], f[p], inv_mass[p], g, h, static_cast<int32_t>(options.initial_guess),
        before.w != 0.0f, {before.x, before.y, before.z});
    target[p] = prediction.target;
    moved[p] = prediction.moved;
    good &= is_finite(prediction.target);
    x[p] = q[p] + prediction.moved;
    if (options.acceleration) newer_[p] = moved[p];
  }
  if (!good) has_bad_inputs_ = true;
}

// Says which of what the prediction reads is not finite.
void StepWork::check_inputs() const {
  const auto check = [](const char* name, size_t row, const Vec3f& v) {
    require(is_finite(v), ErrorKind::Value, kName, ": ", name, "[", row,
            "]: expected finite numbers, got ", v.x, ", ", v.y, ", ", v.z);
  };
  for (size_t p = 0; p < x.size(); ++p) {
    check("state_in.particle_q", p, arrays_.q[p]);
    if (slots.is_held(static_cast<int32_t>(p))) continue;
    check("state_in.particle_qd", p, arrays_.qd[p]);
    check("state_in.particle_f", p, arrays_.f[p]);
  }
  fail(ErrorKind::Value, kName, ": state_in: the inertial target of a particle overflows float32");
}

// Before anything is written to the results.
void StepWork::check_positions() const {
  for (size_t p = 0; p < x.size(); ++p)
    require(is_finite(x[p]), ErrorKind::Runtime, kName, ": particle ", p,
            ": its position is no longer finite after ", iterations_run_,
            " iterations; state_out was not written");
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
  return sum_residuals(of_particles_, iterations_run_);
}

}  // namespace novaphy::vbd
