#include "novaphy/vbd/solver_vbd.h"

#include <algorithm>
#include <cmath>
#include <deque>
#include <utility>
#include <vector>

#include "color_slots.h"
#include "novaphy/core/error.h"
#include "novaphy/core/parallel.h"
#include "step_contacts.h"
#include "sweep.h"

namespace novaphy {
namespace {

constexpr const char* kName = "SolverVBD.step";
constexpr int64_t kParticlesPerChunk = 512;
constexpr int64_t kLanesPerChunk = 64;  // particles of a colour that one thread takes at a time

void check_options(const VbdOptions& o) {
  constexpr const char* name = "SolverVBD: ";
  require(o.iterations >= 0, ErrorKind::Value, name, "iterations: expected >= 0, got ",
          o.iterations);
  require(std::isfinite(o.friction_epsilon) && o.friction_epsilon > 0.0f, ErrorKind::Value, name,
          "friction_epsilon: expected a finite number > 0, got ", o.friction_epsilon);
  require(
      o.initial_guess >= VbdInitialGuess::Inertia && o.initial_guess <= VbdInitialGuess::Adaptive,
      ErrorKind::Value, name, "initial_guess: expected a VbdInitialGuess, got ",
      static_cast<int>(o.initial_guess));
  if (o.acceleration)
    require(*o.acceleration > 0.0f && *o.acceleration < 1.0f, ErrorKind::Value, name,
            "acceleration: expected a spectral radius in (0, 1), or none, got ", *o.acceleration);
  if (o.tolerance)
    require(std::isfinite(*o.tolerance) && *o.tolerance > 0.0f, ErrorKind::Value, name,
            "tolerance: expected a finite number > 0, or none, got ", *o.tolerance);
  require(!o.safeguard || !o.acceleration, ErrorKind::Value, name,
          "safeguard: expected no acceleration besides, which may raise the energy");
  require(std::isfinite(o.lhs_regularization) && o.lhs_regularization >= 0.0f, ErrorKind::Value,
          name, "lhs_regularization: expected a finite number >= 0, got ", o.lhs_regularization);
}

void check_covered(const Model& model) {
  const auto check = [](const char* name, int32_t count) {
    require(count == 0, ErrorKind::NotImplemented, "SolverVBD: model: expected ", name,
            " 0 (they are not there yet), got ", count);
  };
  check("body_count", model.body_count());
  check("joint_count", model.joint_count());
  check("articulation_count", model.articulation_count());
  require(model.device().is_cpu(), ErrorKind::NotImplemented,
          "SolverVBD: model: expected one on the cpu, got one on ", model.device().str());
}

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

struct Row {
  float x = 0.0f, y = 0.0f, z = 0.0f, unused = 0.0f;
  Row() = default;
  Row(const Vec3f& v) : x(v.x), y(v.y), z(v.z) {}
  operator Vec3f() const { return {x, y, z}; }
};

}  // namespace

struct SolverVBD::Work {
  enum class Task : uint8_t { Predict, Prepare, Move, Commit, Accelerate, Finish };
  struct Chunk {
    Task task;
    int32_t iteration;
    int64_t begin, end;  // groups or particles
  };
  struct Stamped {
    const char* name;
    const Array* array;
    DerivedStamp stamp;
  };

  Work(const Model& m, const VbdOptions& o) : model(m), options(o) {
    for (const auto& [name, array] : std::initializer_list<std::pair<const char*, const Array*>>{
             {"particle_colors", &m.particle_colors},
             {"particle_spring_indices", &m.particle_spring_indices},
             {"particle_tri_indices", &m.particle_tri_indices},
             {"particle_edge_indices", &m.particle_edge_indices},
             {"particle_tet_indices", &m.particle_tet_indices}})
      mesh.emplace_back(name, array);
    for (const Array* array : std::initializer_list<const Array*>{
             &m.particle_flags, &m.particle_mass, &m.particle_inv_mass,
             &m.particle_spring_stiffness, &m.particle_spring_damping,
             &m.particle_spring_rest_length, &m.particle_tri_pose, &m.particle_tri_area,
             &m.particle_tri_material, &m.particle_edge_rest_angle, &m.particle_edge_rest_length,
             &m.particle_edge_material, &m.particle_tet_pose, &m.particle_tet_material})
      values.emplace_back("", array);
    const auto n = static_cast<size_t>(m.particle_count());
    for (std::vector<Row>* rows : {&start, &target, &moved, &x}) rows->resize(n);
    build();
    for (Stamped& s : mesh) s.stamp.set(*s.array);
  }

  void build() {
    slots.build(model, level.lanes);
    if (slots.has_conflicts()) next.resize(x.size());
    plan();
    for (Stamped& s : values) s.stamp.set(*s.array);
    constants = {};
  }

  // All chunks of a step, and where its phases end.
  void plan() {
    chunks.clear();
    ends.clear();
    const auto phase = [&](Task task, int32_t iteration, int64_t begin, int64_t end, int64_t size) {
      if (begin == end) return;
      for (int64_t first = begin; first < end; first += size)
        chunks.push_back({task, iteration, first, std::min(first + size, end)});
      ends.push_back(static_cast<int64_t>(chunks.size()));
    };
    const auto n = static_cast<int64_t>(x.size());
    const std::vector<int64_t>& colors = slots.color_begin();
    const int64_t groups_per_chunk = kLanesPerChunk / level.lanes;
    phase(Task::Predict, 0, 0, n, kParticlesPerChunk);
    phase(Task::Prepare, 0, 0, colors.back(), groups_per_chunk);
    iteration_ends.assign(1, ends.size());
    for (int32_t k = 1; k <= options.iterations; ++k) {
      for (size_t c = 0; c + 1 < colors.size(); ++c) {
        phase(Task::Move, k, colors[c], colors[c + 1], groups_per_chunk);
        if (slots.has_conflicts())
          phase(Task::Commit, k, colors[c], colors[c + 1], groups_per_chunk);
      }
      if (options.acceleration) phase(Task::Accelerate, k, 0, n, kParticlesPerChunk);
      iteration_ends.push_back(ends.size());
    }
    phase(Task::Finish, 0, 0, n, kParticlesPerChunk);
    if (options.acceleration) {
      newer.resize(x.size());
      older.resize(x.size());
    }
  }

  void update(const Control* control, const Contacts* contact_rows, float step_dt) {
    for (const Stamped& s : mesh)
      require(s.stamp.matches(*s.array), ErrorKind::Value, kName, ": model.", s.name,
              ": it was edited after the solver was made; make a new one");
    const bool changed = std::any_of(values.begin(), values.end(),
                                     [](const Stamped& s) { return !s.stamp.matches(*s.array); });
    if (changed) build();
    const auto& tri =
        control != nullptr ? control->particle_tri_activation : model.particle_tri_activation;
    const auto& tet =
        control != nullptr ? control->particle_tet_activation : model.particle_tet_activation;
    if (constants.dt != step_dt || !activation[0].matches(tri) || !activation[1].matches(tet)) {
      constants = {tri.data(), tet.data(), step_dt};
      slots.set_constants(model, constants);
      activation[0].set(tri);
      activation[1].set(tet);
    }
    contacts.update(model, contact_rows, step_dt);
    if (!world.matches(model.particle_world)) {
      for (int32_t p = 0; p < model.particle_count(); ++p) {
        const int32_t w = model.particle_world.data()[p];
        require(w >= -1 && w < model.world_count(), ErrorKind::Index, kName,
                ": model.particle_world[", p, "]: expected -1 to ", model.world_count() - 1,
                ", got ", w);
      }
      world.set(model.particle_world);
    }

    slots.fill(sweep);
    contacts.fill(sweep);
    const auto floats = [](std::vector<Row>& rows) {
      return reinterpret_cast<float*>(rows.data());
    };
    sweep.start = floats(start);
    sweep.target = floats(target);
    sweep.moved = floats(moved);
    sweep.x = floats(x);
    sweep.step = slots.has_conflicts() ? floats(next) : nullptr;
    sweep.regularization = options.lhs_regularization;
    sweep.slip = options.friction_epsilon * step_dt;
    sweep.safeguard = options.safeguard;
  }

  void run_phases(size_t first, size_t last) {
    const int64_t begin = first == 0 ? 0 : ends[first - 1];
    parallel_phases(
        begin, std::span<const int64_t>(ends).subspan(first, last - first),
        [](void* work, int64_t chunk) { static_cast<Work*>(work)->run(chunk); }, this);
  }

  void run(int64_t number) {
    const Chunk& chunk = chunks[static_cast<size_t>(number)];
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
          x[p] = next[p];
        }
        return;
      case Task::Accelerate:
        return accelerate(chunk);
      case Task::Finish:
        return finish(chunk.begin, chunk.end);
    }
  }

  void predict(int64_t begin, int64_t end) {
    const Vec3f* q = in->particle_q.data();
    const Vec3f* qd = in->particle_qd.data();
    const Vec3f* f = in->particle_f.data();
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
      if (options.acceleration) newer[p] = moved[p];
    }
  }

  // The part of gravity, 0 to 1, in the acceleration of the step before.
  static float gravity_that_acted(const Vec3f& g, const Vec3f& acceleration) {
    const float squared = math::dot(g, g);
    return squared > 0.0f ? math::clamp(math::dot(acceleration, g) / squared, 0.0f, 1.0f) : 0.0f;
  }

  void accelerate(const Chunk& chunk) {
    const float omega = chebyshev[static_cast<size_t>(chunk.iteration)];
    for (int64_t i = chunk.begin; i < chunk.end; ++i) {
      const auto p = static_cast<size_t>(i);
      const auto particle = static_cast<int32_t>(i);
      if (chunk.iteration > 1 && !slots.is_held(particle) && !contacts.touches(particle)) {
        const Vec3f before = older[p];
        moved[p] = (Vec3f(moved[p]) - before) * omega + before;
        x[p] = Vec3f(start[p]) + Vec3f(moved[p]);
      }
      older[p] = newer[p];
      newer[p] = moved[p];
    }
  }

  void finish(int64_t begin, int64_t end) {
    Vec3f* const q = out_q;
    Vec3f* const qd = out_qd;
    for (int64_t i = begin; i < end; ++i) {
      const auto p = static_cast<size_t>(i);
      q[p] = x[p];
      qd[p] = (Vec3f(x[p]) - Vec3f(start[p])) / constants.dt;
    }
  }

  void move_held(const DeviceArray<Vec3f>* targets) {
    if (targets == nullptr) return;
    const Vec3f* to = targets->data();
    for (const int32_t held : slots.held()) x[static_cast<size_t>(held)] = *to++;
  }

  VbdResidual residual() {
    of_particles.assign(x.size(), {});
    for (int64_t group = 0; group < slots.color_begin().back(); ++group)
      level.residual(sweep, group, of_particles.data());
    double force = 0.0, inertia = 0.0, rounding = 0.0;
    for (const vbd::ParticleResidual& r : of_particles) {
      force += static_cast<double>(r.force);
      inertia += static_cast<double>(r.inertia);
      rounding += static_cast<double>(r.rounding);
    }
    const auto relative = [&](double squared) {
      return squared > 0.0 ? std::sqrt(squared / inertia) : 0.0;
    };
    return {std::sqrt(force), std::sqrt(inertia), relative(force), relative(rounding),
            iterations_run};
  }

  // Until the residual is small enough.
  void iterate() {
    for (iterations_run = 0; iterations_run < options.iterations;) {
      ++iterations_run;
      const auto k = static_cast<size_t>(iterations_run);
      run_phases(iteration_ends[k - 1], iteration_ends[k]);
      if (residual().relative <= static_cast<double>(*options.tolerance)) return;
    }
  }

  const Model& model;
  const VbdOptions options;
  const vbd::SweepLevel& level = vbd::sweep_level();
  vbd::ColorSlots slots;
  vbd::ColorSlots::Constants constants;
  vbd::StepContacts contacts;
  vbd::Sweep sweep;
  std::deque<Stamped> mesh, values;
  DerivedStamp activation[2], world;

  std::vector<Chunk> chunks;
  std::vector<int64_t> ends;
  std::vector<size_t> iteration_ends;  // phases
  std::vector<float> chebyshev;        // per iteration

  std::vector<Row> start, target, moved, x, next, newer, older;
  std::vector<Vec3f> last_velocity;
  std::vector<vbd::ParticleResidual> of_particles;
  bool has_last = false, has_stepped = false;
  int32_t iterations_run = 0;
  // Of the present step.
  const SimState* in = nullptr;
  Vec3f *out_q = nullptr, *out_qd = nullptr;
};

SolverVBD::SolverVBD(std::shared_ptr<const Model> model, const VbdOptions& options)
    : SolverBase(std::move(model)), options_(options) {
  check_options(options);
  check_covered(*this->model());
  this->model()->update_derived();
  work_ = std::make_unique<Work>(*this->model(), options);
  if (!options.acceleration) return;
  // Chebyshev's factors: 1, 2/(2 - rho^2), then 4/(4 - rho^2 omega).
  const double rho2 = static_cast<double>(*options.acceleration) * *options.acceleration;
  double omega = 1.0;
  for (int32_t k = 0; k <= options.iterations; ++k) {
    if (k >= 2) omega = k == 2 ? 2.0 / (2.0 - rho2) : 4.0 / (4.0 - rho2 * omega);
    work_->chebyshev.push_back(static_cast<float>(omega));
  }
}

SolverVBD::~SolverVBD() = default;

int32_t SolverVBD::held_count() const { return static_cast<int32_t>(work_->slots.held().size()); }

void SolverVBD::notify_model_changed(ModelFlags) {
  const ExclusiveUse::Scope scope = use("SolverVBD.notify_model_changed");
  model()->update_derived();
  work_->build();
}

void SolverVBD::reset() {
  const ExclusiveUse::Scope scope = use("SolverVBD.reset");
  work_->has_last = work_->has_stepped = false;
}

VbdResidual SolverVBD::residual() const {
  const ExclusiveUse::Scope scope = use("SolverVBD.residual");
  require(work_->has_stepped, ErrorKind::Runtime,
          "SolverVBD.residual: expected a step before, since the solver was made or reset");
  return work_->residual();
}

void SolverVBD::step(SimState& state_in, SimState& state_out, const Control* control,
                     const Contacts* contacts, float dt, const DeviceArray<Vec3f>* targets) {
  if (ArrayObserver* observer = array_observer()) observer->untracked_operation(kName);
  const ExclusiveUse::Scope scope = use(kName);
  const Model& m = *model();
  Work& w = *work_;
  check_step(kName, state_in, state_out, control, contacts, dt);
  check_numbers(m);
  m.update_derived();
  w.update(control, contacts, dt);
  const auto held = w.slots.held().size();
  require(targets == nullptr || (targets->rows() == held && targets->device() == m.device()),
          ErrorKind::Value, kName, ": targets: expected {", held,
          ", 3}, a position for every held particle, got ",
          targets == nullptr ? 0 : targets->rows(), " rows");

  w.in = &state_in;
  w.out_q = state_out.particle_q.mutable_data();
  w.out_qd = state_out.particle_qd.mutable_data();
  const size_t first = w.iteration_ends.front(), last = w.iteration_ends.back();
  w.run_phases(0, first);
  w.move_held(targets);
  if (w.options.tolerance) {
    w.iterate();
  } else {
    w.run_phases(first, last);
    w.iterations_run = w.options.iterations;
  }
  w.run_phases(last, w.ends.size());
  if (w.options.initial_guess == VbdInitialGuess::Adaptive) {
    w.last_velocity.resize(w.x.size());
    state_in.particle_qd.copy_to_host(std::span<Vec3f>(w.last_velocity));
    w.has_last = true;
  }
  w.has_stepped = true;
}

}  // namespace novaphy
