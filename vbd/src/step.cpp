#include "step.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <string_view>

#include "element_arrays.h"
#include "novaphy/core/assert.h"
#include "novaphy/core/builtin_kernels.h"
#include "novaphy/core/error.h"
#include "step_options.h"

namespace novaphy::vbd {
namespace {

constexpr const char* kName = "SolverVBD.step";

bool has_code_for(Device device) {
  return device.type == DeviceType::CUDA ? NOVAPHY_VBD_CUDA : NOVAPHY_VBD_DLAN;
}

template <class Slot>
void check_activation(const Model& m, const DeviceArray<float>& activation) {
  Slot::for_arrays(m, [&](const char* name, const Array&, int, ArrayUse use) {
    for (size_t e = 0; use == kActivation && e < activation.rows(); ++e)
      require(std::isfinite(activation.data()[e]), ErrorKind::Value, kName, ": ", name, "[", e,
              "]: expected a finite number, got ", activation.data()[e]);
  });
}

VbdTableArguments tables_of(const StepInputs& in, const Model& m) {
#define NOVAPHY_VBD_TABLE(array, columns, width, use) \
  .array = Untyped(source_of<use>(in.activations, m).array),
  return {NOVAPHY_VBD_PARAMETERS(NOVAPHY_VBD_TABLE).particle_mass = m.particle_mass,
          .particle_flags = m.particle_flags, .particle_spring_control = m.particle_spring_control};
#undef NOVAPHY_VBD_TABLE
}

}  // namespace

Step::Step(const Model& m, const VbdOptions& o, bool damps_inside)
    : model_(m),
      options_(o),
      damps_inside_(damps_inside),
      on_cpu_(m.device().is_cpu()),
      materials_("SolverVBD", {.kf = false, .ka = false}) {
  if (!on_cpu_) {
    require(has_code_for(m.device()), ErrorKind::NotImplemented,
            "SolverVBD: model: expected one on the cpu, got one on ", m.device().str(),
            ": this build has no code of VBD for it (NOVAPHY_WITH_VBD_",
            m.device().type == DeviceType::CUDA ? "CUDA)" : "DLAN)");
    check_not_launched(o);
  }
  const auto stamped = [](std::deque<Stamped>& all, const char* name, const Array& array) {
    Stamped& s = all.emplace_back();
    s.name = name;
    s.array = &array;
  };
  stamped(mesh_, "particle_colors", m.particle_colors);
  for_each_kind([&](auto is) {
    using Element = typename decltype(is)::Slot;
    Element::with_indices(
        m, [&](const char* name, const Array& array) { stamped(mesh_, name, array); });
    Element::for_flags(m,
                       [&](const char* name, const Array& array) { stamped(mesh_, name, array); });
    Element::for_arrays(m, [&](const char* name, const Array& array, int, ArrayUse use) {
      if (use != kActivation) stamped(values_, name, array);
    });
  });
  of_elements_ = values_.size();
  for (const Array* array : std::initializer_list<const Array*>{
           &m.particle_mass, &m.particle_inv_mass, &m.particle_flags, &m.particle_world,
           &m.particle_spring_control})
    stamped(values_, "", *array);
  for (const std::deque<Stamped>* all : {&mesh_, &values_})
    for (const Stamped& s : *all) read_.push_back(s.array);
  const auto n = static_cast<size_t>(m.particle_count());
  for (Rows4* rows : {&start_, &target_, &moved_, &x_}) *rows = Rows4(n, device());
  of_particles_ = DeviceArray<float>(3 * n, device());
  residuals_.resize(n);
  faults_ = DeviceArray<int32_t>(n, device());
  overflow_ = DeviceArray<int32_t>(2, device());
  if (o.acceleration) {
    newer_ = Rows4(n, device());
    older_ = Rows4(n, device());
    chebyshev_ = chebyshev_factors(*o.acceleration, o.iterations);
  }
  const UntrackedScope untracked;
  edited_.check(m);
  build();
  materials_.check(host_model());
  for (Stamped& s : mesh_) s.stamp.set(*s.array);
}

void Step::build() {
  const UntrackedScope untracked;
  copy_ = model_.on_host();
  const Model& m = host_model();
  for (int32_t p = 0; p < m.particle_count(); ++p) {
    const int32_t w = m.particle_world.data()[p];
    require(w >= -1 && w < m.world_count(), ErrorKind::Index, kName, ": model.particle_world[", p,
            "]: expected -1 to ", m.world_count() - 1, ", got ", w);
  }
  slots_.build(m, lanes_on(device()));
  if (options_.coarse) coarse_.emplace(m, slots_, device());
  if (options_.self_contact) self_contact_.emplace(model_, slots_, *options_.self_contact);
  ++builds_;
  is_kinematic_ = upload<int32_t>(slots_.kinematic_flags(), device());
  kinematic_ = upload<int32_t>(slots_.kinematic(), device());
  if (slots_.has_conflicts() && next_.rows() == 0) next_ = Rows4(x_.rows(), device());
  for (Stamped& s : values_) s.stamp.set(*s.array);
  tables_.reset();
  forget_lists();
}

void Step::forget_lists() {
  for (auto& of_contacts : lists_)
    for (auto& of_damping : of_contacts)
      for (std::optional<StepList>& list : of_damping) list.reset();
  list_ = nullptr;
  ++version_;
}

void Step::reserve_contacts(int32_t slots) {
  const auto count = static_cast<size_t>(slots);
  if (contact_items_.rows() >= count) return;
  const UntrackedScope untracked;
  contact_begin_ = DeviceArray<int32_t>(x_.rows() + 1, device());
  contact_items_ = DeviceArray<int32_t>(count, device());
  contact_numbers_ = DeviceArray<float>(count * kContactFloats, device());
  forget_lists();
}

void Step::update(float dt, bool damps) {
  const UntrackedScope untracked;
  if (was_recorded_ && is_immediate()) check();
  materials_.check(host_model());
  edited_.check(model_);
  check_numbers(model_);
  for (const Stamped& s : mesh_)
    require(s.stamp.matches(*s.array), ErrorKind::Value, kName, ": model.", s.name,
            ": it was edited after the solver was made; make a new one");
  if (std::any_of(values_.begin(), values_.end(),
                  [](const Stamped& s) { return !s.stamp.matches(*s.array); }))
    build();
  if (!tables_ || tables_->dt != dt) build_tables(dt);
  damps_ = damps;
}

VbdSweepArguments Step::sweep(int64_t first_group, int64_t end_group) const {
  const Tables& t = *tables_;
  return {.particle = t.particle,
          .filled = t.filled,
          .mass_by_h2 = t.mass_by_h2,
          .begin = t.begin,
          .ints = t.ints,
          .floats = t.floats,
          .contact_begin = self_contact_   ? &self_contact_->begins()
                           : has_contacts_ ? &contact_begin_
                                           : nullptr,
          .contacts = self_contact_   ? &self_contact_->numbers()
                      : has_contacts_ ? &contact_numbers_
                                      : nullptr,
          .start = start_,
          .target = target_,
          .moved = moved_,
          .x = x_,
          .to = slots_.has_conflicts() ? next_ : x_,
          .regularization = options_.lhs_regularization,
          .slip = options_.friction_epsilon * t.dt,
          .inside = damps_inside_ ? 1.0f : 0.0f,
          .lanes = slots_.lanes(),
          .damped = damps_ ? (int64_t{1} << kRoles) - 1 : t.damped,
          .turns = int{coarse() != nullptr},
          .first_group = first_group,
          .end_group = end_group,
          .block_groups = t.block_groups,
          .residual = of_particles_};
}

// Returns the number of groups of a thread block if thread blocks move the colors. Returns 0 if
// single threads move the particles.
int64_t Step::find_mover() const {
  if (tables_->block_groups == 0) return 0;
  const char* const variable = std::getenv("NOVAPHY_VBD_SWEEP");
  const std::string_view wanted = variable != nullptr ? variable : "";
  // "team" is the value of earlier versions for "block".
  require(wanted.empty() || wanted == "thread" || wanted == "block" || wanted == "team",
          ErrorKind::Value, "NOVAPHY_VBD_SWEEP: expected thread or block, got '", wanted, "'");
  return options_.safeguard || wanted == "thread" ? 0 : tables_->block_groups;
}

// Writes activations into the slots whose stored activation differs.
void Step::activate(const StepInputs& in) {
  for_activated_roles([&](auto is) {
    using Slot = typename decltype(is)::Slot;
    const DeviceArray<float>& activation = activation_in<Slot>(in, model_);
    DerivedStamp& held = tables_->activations[is.role];
    if (is_immediate() && !tables_->is_recorded) {
      if (held.matches(activation)) return;
      check_activation<Slot>(model_, activation);
      held.set(activation);
    }
    put_numbers<is.role>(in, kernels().activation);
  });
}

// Computes the numbers of the slots of a role from the current model.
template <Role role>
void Step::put_numbers(const StepInputs& in, const Kernel<VbdNumbersArguments>& numbers) const {
  using Slot = SlotOf<role>;
  const Tables& t = *tables_;
  const auto of_step = [&](const Array& array) {
    if constexpr (Slot::kActivated >= 0)
      if (&array == &Slot::activation(model_)) return Untyped(activation_in<Slot>(in, model_));
    return Untyped(array);
  };
  if (const auto rows = static_cast<int64_t>(t.sources[role].rows()); rows != 0)
    novaphy::run(numbers, rows,
                 {.source = t.sources[role],
                  .floats = t.floats[role],
                  .role = int{role},
                  .lanes = slots_.lanes(),
                  .h = t.dt,
                  .parameters = parameter_arrays<Slot>(model_, of_step)});
}

void Step::find_contacts(const Contacts& c) const {
  const auto particles = static_cast<int64_t>(model_.particle_count());
  novaphy::run(incidence(), particles,
               {.table = c.soft_contact_particle,
                .slots = c.soft_contact_max(),
                .offsets = contact_begin_,
                .items = contact_items_});
  novaphy::run(kernels().contact, c.soft_contact_max(),
               {.begin = contact_begin_,
                .items = contact_items_,
                .particles = particles,
                .count = c.soft_contact_count,
                .overflow = overflow_,
                .particle = c.soft_contact_particle,
                .shape = c.soft_contact_shape,
                .point = c.soft_contact_body_pos,
                .velocity = c.soft_contact_body_vel,
                .normal = c.soft_contact_normal,
                .particle_radius = model_.particle_radius,
                .shape_margin = model_.shape_margin,
                .shape_material_ke = model_.shape_material_ke,
                .shape_material_kd = model_.shape_material_kd,
                .shape_material_mu = model_.shape_material_mu,
                .model_ke = model_.soft_contact_ke,
                .model_kd = model_.soft_contact_kd,
                .model_mu = model_.soft_contact_mu,
                .h = tables_->dt,
                .numbers = contact_numbers_});
}

VbdCommitArguments Step::commit(int64_t first_group, const Rows4& from) const {
  return {.particle = tables_->particle,
          .first_lane = first_group * slots_.lanes(),
          .from = from,
          .x = x_};
}

StepList& Step::list_for(const StepInputs& in, const StepResults& out) {
  if (const int64_t block_groups = find_mover(); block_groups != block_groups_) {
    forget_lists();
    block_groups_ = block_groups;
  }
  if (out.keeps_iterates) reserve_iterates();
  const Model& m = model_;
  const VbdPredictArguments predict = {.particle_q = in.q,
                                       .particle_qd = in.qd,
                                       .particle_f = in.f,
                                       .particle_inv_mass = m.particle_inv_mass,
                                       .world = m.particle_world,
                                       .gravity = m.gravity,
                                       .last_world = m.world_count() - 1,
                                       .is_kinematic = is_kinematic_,
                                       .h = tables_->dt,
                                       .guess = static_cast<int64_t>(options_.initial_guess),
                                       .last_velocity = if_any(in.last_velocity),
                                       .start = start_,
                                       .target = target_,
                                       .moved = moved_,
                                       .x = x_,
                                       .newer = newer_,
                                       .faults = faults_,
                                       .tables = tables_of(in, m)};
  const VbdFinishArguments finish = {
      .start = start_,
      .x = x_,
      .h = tables_->dt,
      .q = out.q,
      .qd = out.qd,
      .faults = faults_,
      .qd_before = in.qd,
      .last_velocity = out.updates_last ? &in.last_velocity : nullptr};
  std::optional<StepList>& list = lists_[has_contacts_][damps_][out.keeps_iterates];
  if (!list)
    return list.emplace(
        *this, predict, finish,
        out.keeps_iterates ? std::span<const Rows4>(iterates_) : std::span<const Rows4>(),
        out.keeps_iterates ? std::span<const Rows4>(searches_) : std::span<const Rows4>());
  list->set(predict);
  list->set(finish);
  return *list;
}

VbdAccelerateArguments Step::acceleration(int32_t iteration) const {
  return {.is_kinematic = is_kinematic_,
          .contact_begin = has_contacts_ ? &contact_begin_ : nullptr,
          .omega = chebyshev_[static_cast<size_t>(iteration)],
          .iteration = iteration,
          .start = start_,
          .moved = moved_,
          .x = x_,
          .newer = newer_,
          .older = older_};
}

void Step::run(const StepInputs& in, const StepResults& out,
               const std::shared_ptr<ExclusiveUse>& in_use, Bodies* bodies) {
  const bool is_immediate = this->is_immediate();
  has_contacts_ = in.contacts != nullptr && in.contacts->soft_contact_max() > 0;
  if (is_immediate && has_contacts_) {
    check_contacts(*in.contacts, bodies != nullptr);
    has_contacts_ = *in.contacts->soft_contact_count.data() > 0;
  }
  if (has_contacts_) reserve_contacts(in.contacts->soft_contact_max());
  if (!is_immediate) {
    check_not_launched(options_);
    was_recorded_ = true;
    if (LaunchRecorder* recorder = launch_recorder()) recorder->uses(in_use);
    tables_->is_recorded = true;
    model_.depend_on_numbers();
    const std::span<const Array* const> read = read_;
    depend_on(read.first(mesh_.size()));
    depend_on(read.subspan(mesh_.size() + (in.trains_elements ? of_elements_ : 0)));
  }
  list_ = &list_for(in, out);
  list_->predict();
  if (is_immediate) check_inputs(in);
  if (in.trains_elements) {
    watch_materials();
    for_roles([&](auto is) { put_numbers<is.role>(in, kernels().numbers); });
  } else {
    activate(in);
  }
  if (has_contacts_) find_contacts(*in.contacts);
  list_->prepare();
  if (in.targets.rows() != 0)
    novaphy::run(kernels().target, kinematic_count(),
                 {.kinematic = kinematic_, .targets = in.targets, .x = x_});
  iterations_run_ = options_.iterations;
  if (bodies != nullptr) couple(*bodies, in.contacts);
  if (self_contact_) {
    iterate_in_contact(bodies);
  } else if (bodies != nullptr) {
    iterate_with(*bodies);
  } else if (options_.tolerance) {
    iterate_to(static_cast<double>(*options_.tolerance), *list_);
  } else {
    list_->iterate(0, static_cast<size_t>(options_.iterations));
  }
  if (is_immediate) check_positions();
  list_->balance();
  if (bodies != nullptr) end_with(*bodies);
  list_->finish();
}

void Step::iterate_again() {
  list_->move_again();
  ++iterations_run_;
}

void Step::finish_again() const {
  list_->balance();
  list_->finish();
}

}  // namespace novaphy::vbd
