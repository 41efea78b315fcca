#include "step_work.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <utility>

#include "novaphy/core/error.h"
#include "step_options.h"

namespace novaphy::vbd {
namespace {

constexpr const char* kName = "SolverVBD.step";

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
  faults_.resize(n);
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
  list_.reset();
  for (Stamped& s : values_) s.stamp.set(*s.array);
  constants = {};
}

// What the sweep as it is reads and writes.
VbdSweepArguments StepWork::sweep_arguments() {
  Direct<const int64_t> begin[kRoles];
  Direct<const int32_t> ints[kRoles];
  Direct<float> numbers[kRoles];
  int64_t damped = 0;
  for (int role = 0; role < kRoles; ++role) {
    const SlotTable& table = sweep.slots[role];
    begin[role] = {table.begin};
    ints[role] = {table.ints};
    numbers[role] = {table.floats};
    damped |= int64_t{table.damped} << role;
  }
  return {.particle = direct(sweep.particle),
          .filled = direct(sweep.filled),
          .mass_by_h2 = direct(sweep.mass_by_h2),
          .begin = begin,
          .ints = ints,
          .floats = numbers,
          .contact_begin = direct(sweep.contact_begin),
          .contacts = direct(sweep.contacts),
          .start = direct(start),
          .target = direct(target),
          .moved = direct(moved),
          .x = direct(x),
          .to = direct(slots.has_conflicts() ? next_ : x),
          .regularization = sweep.regularization,
          .slip = sweep.slip,
          .lanes = level.lanes,
          .damped = damped,
          .first_group = 0,
          .end_group = 0,
          .team = 0,
          .residual = direct<float>(nullptr)};
}

// What a step of `arrays_` reads and writes.
StepArguments StepWork::arguments() {
  const Model& m = model;
  return {.predict = {.particle_q = direct(arrays_.q),
                      .particle_qd = direct(arrays_.qd),
                      .particle_f = direct(arrays_.f),
                      .particle_inv_mass = m.particle_inv_mass,
                      .world = m.particle_world,
                      .gravity = m.gravity,
                      .last_world = m.world_count() - 1,
                      .is_held = direct(slots.held_flags()),
                      .h = constants.dt,
                      .guess = static_cast<int64_t>(options.initial_guess),
                      .last_velocity = direct(reinterpret_cast<const VbdRow*>(arrays_.last)),
                      .next_last_velocity = nullptr,
                      .start = direct(start),
                      .target = direct(target),
                      .moved = direct(moved),
                      .x = direct(x),
                      .newer = direct(newer_),
                      .faults = direct(faults_),
                      .tables = tables_of(m)},
          .sweep = sweep_arguments(),
          .newer = direct(newer_),
          .older = direct(older_),
          .finish = {.start = direct(start),
                     .x = direct(x),
                     .h = constants.dt,
                     .q = direct(arrays_.q_out),
                     .qd = direct(arrays_.qd_out),
                     .faults = direct(faults_)}};
}

// The list for `arrays_`; made anew where its tables are others.
void StepWork::make_list() {
  const StepArguments a = arguments();
  if (list_ && std::memcmp(&a.sweep, &*listed_, sizeof(a.sweep)) == 0) {
    list_->set(a.predict);
    list_->set(a.finish);
    return;
  }
  std::vector<WritesRow<VbdRow>> kept;
  for (std::vector<Row>& rows : iterates) kept.emplace_back(direct(rows));
  list_.emplace(StepPlan{.device = Device::cpu(),
                         .particles = static_cast<int64_t>(x.size()),
                         .lanes = level.lanes,
                         .colors = slots.color_begin(),
                         .has_conflicts = slots.has_conflicts(),
                         .safeguard = options.safeguard,
                         .iterations = options.iterations,
                         .chebyshev = chebyshev_},
                a, kept);
  listed_.emplace(a.sweep);
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
  make_list();
  list_->predict_and_prepare();
  if (std::any_of(faults_.begin(), faults_.end(), [](int32_t fault) { return fault != kNoFault; }))
    check_inputs();
  if (targets != nullptr)
    for (const int32_t held : slots.held()) x[static_cast<size_t>(held)] = *targets++;
  if (options.tolerance) {
    iterate();
  } else {
    list_->iterate(0, static_cast<size_t>(options.iterations));
    iterations_run_ = options.iterations;
  }
  check_positions();
  list_->finish();
  has_stepped = true;
}

void StepWork::iterate_again() {
  const auto last = static_cast<size_t>(options.iterations);
  list_->iterate(last - 1, last);
  ++iterations_run_;
}

void StepWork::finish_again() { list_->finish(); }

// Until the residual is small enough.
void StepWork::iterate() {
  for (iterations_run_ = 0; iterations_run_ < options.iterations;) {
    ++iterations_run_;
    const auto k = static_cast<size_t>(iterations_run_);
    list_->iterate(k - 1, k);
    if (residual().relative <= static_cast<double>(*options.tolerance)) return;
  }
}

// Says which of what the prediction reads is not finite.
void StepWork::check_inputs() {
  std::fill(faults_.begin(), faults_.end(), kNoFault);
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

VbdResidual StepWork::residual() {
  of_particles_.assign(x.size(), {});
  for (int64_t group = 0; group < slots.color_begin().back(); ++group)
    level.residual(sweep, group, of_particles_.data());
  return sum_residuals(of_particles_, iterations_run_);
}

}  // namespace novaphy::vbd
