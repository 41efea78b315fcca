#include "launched_step.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <string_view>
#include <utility>

#include "novaphy/core/assert.h"
#include "novaphy/core/builtin_kernels.h"
#include "novaphy/core/error.h"
#include "step_options.h"
#include "vbd_kernels.h"

namespace novaphy::detail {
const char* vbd_kernels_text();
}  // namespace novaphy::detail

namespace novaphy::vbd {
namespace {

constexpr const char* kName = "SolverVBD.step";

// Never destroyed: recordings refer to them.
struct Kernels {
#define NOVAPHY_VBD_KERNEL(name) \
  Kernel<decltype(vbd_##name)::Arguments> name{vbd_##name, detail::vbd_kernels_text};
  NOVAPHY_VBD_KERNEL(target)
  NOVAPHY_VBD_KERNEL(activation)
  NOVAPHY_VBD_KERNEL(contact)
#undef NOVAPHY_VBD_KERNEL
};
const Kernels& kernels() {
  static const auto& all = *new Kernels;
  return all;
}

bool has_code_for(Device device) {
  return device.type == DeviceType::CUDA ? NOVAPHY_VBD_CUDA : NOVAPHY_VBD_DLAN;
}

// Colours of at least so many large teams fill a device.
constexpr int64_t kManyTeams = 256;

}  // namespace

LaunchedStep::LaunchedStep(const Model& m, const VbdOptions& o)
    : model_(m),
      options_(o),
      on_cpu_(m.device().is_cpu()),
      materials_("SolverVBD", {.kf = false, .ka = false}) {
  require(on_cpu_ || has_code_for(m.device()), ErrorKind::NotImplemented,
          "SolverVBD: model: expected one on the cpu, got one on ", m.device().str(),
          ": this build has no code of VBD for it (NOVAPHY_WITH_VBD_",
          m.device().type == DeviceType::CUDA ? "CUDA)" : "DLAN)");
  require(!o.tolerance, ErrorKind::NotImplemented,
          "SolverVBD: tolerance: a step that is launched does not ask how far it is (on a device, "
          "or in a capture); set iterations");
  mesh_ = {&m.particle_colors,       &m.particle_spring_indices, &m.particle_tri_indices,
           &m.particle_edge_indices, &m.particle_tet_indices,    &m.particle_world};
  values_ = {&m.particle_spring_stiffness,   &m.particle_spring_damping,
             &m.particle_spring_rest_length, &m.particle_tri_pose,
             &m.particle_tri_area,           &m.particle_tri_material,
             &m.particle_edge_rest_angle,    &m.particle_edge_rest_length,
             &m.particle_edge_material,      &m.particle_tet_pose,
             &m.particle_tet_material,       &m.particle_mass,
             &m.particle_inv_mass,           &m.particle_flags,
             &m.particle_spring_control};
  const auto n = static_cast<size_t>(m.particle_count());
  const Device device = m.device();
  for (DeviceArray<Vec4f>* rows : {&start_, &target_, &moved_, &x_})
    *rows = DeviceArray<Vec4f>(n, device);
  of_particles_ = DeviceArray<float>(3 * n, device);
  faults_ = DeviceArray<int32_t>(n, device);
  overflow_ = DeviceArray<int32_t>(2, device);
  if (o.acceleration) {
    newer_ = DeviceArray<Vec4f>(n, device);
    older_ = DeviceArray<Vec4f>(n, device);
    chebyshev_ = chebyshev_factors(*o.acceleration, o.iterations);
  }
  const Unobserved unobserved;
  edited_.check(m);
  build_slots();
  mesh_stamps_.resize(mesh_.size());
  for (size_t k = 0; k < mesh_.size(); ++k) mesh_stamps_[k].set(*mesh_[k]);
}

// The model, or a copy of it as it is now.
const Model& LaunchedStep::on_host() {
  if (on_cpu_) return model_;
  copy_ = model_.to(Device::cpu());
  return *copy_;
}

void LaunchedStep::build_slots() {
  const Model& m = on_host();
  materials_.check(m);
  for (int32_t p = 0; p < m.particle_count(); ++p) {
    const int32_t w = m.particle_world.data()[p];
    require(w >= -1 && w < m.world_count(), ErrorKind::Index, kName, ": model.particle_world[", p,
            "]: expected -1 to ", m.world_count() - 1, ", got ", w);
  }
  slots_.build(m, on_cpu_ ? level_.lanes : kVbdLanes);
  const Device device = model_.device();
  const auto n = static_cast<size_t>(m.particle_count());
  ++builds_;
  is_held_ = upload<int32_t>(slots_.held_flags(), device);
  held_ = upload<int32_t>(slots_.held(), device);
  if (slots_.has_conflicts() && next_.rows() != n) next_ = DeviceArray<Vec4f>(n, device);
  value_stamps_.resize(values_.size());
  for (size_t k = 0; k < values_.size(); ++k) value_stamps_[k].set(*values_[k]);
  forget_tables();
}

void LaunchedStep::forget_tables() {
  tables_ = nullptr;
  for (std::optional<StepList>& list : lists_) list.reset();
}

void LaunchedStep::build_tables(float dt) {
  const Model& m = on_cpu_ ? model_ : *copy_;
  const Device device = model_.device();
  auto t = std::make_shared<Tables>();
  // Activations are those of the step.
  const std::vector<float> tri(m.particle_tri_activation.rows()),
      tet(m.particle_tet_activation.rows());
  slots_.set_constants(m, {tri.data(), tet.data(), dt});
  Sweep host;
  slots_.fill(host);
  const auto lanes = static_cast<size_t>(slots_.lanes());
  t->dt = dt;
  t->colors = slots_.color_begin();
  t->has_conflicts = slots_.has_conflicts();
  const auto groups = static_cast<size_t>(t->colors.back());
  NOVAPHY_ASSERT(std::is_sorted(t->colors.begin(), t->colors.end()));
  for (size_t c = 0; c + 1 < t->colors.size(); ++c)
    t->most_groups = std::max(t->most_groups, t->colors[c + 1] - t->colors[c]);
  t->particle = upload<int32_t>(host.particle, groups * lanes, device);
  t->filled = upload<int32_t>(host.filled, groups, device);
  t->mass_by_h2 = upload<float>(host.mass_by_h2, groups * lanes, device);
  for (int role = 0; role < kRoles; ++role) {
    const ColorSlots::Table& table = slots_.table(static_cast<Role>(role));
    if (table.sources.empty()) continue;
    t->begin[role] = upload<uint64_t>(table.begin, device);
    t->ints[role] = upload<int32_t>(table.ints, device);
    t->floats[role] = upload<float>(table.floats, device);
    if (table.damped) t->damped |= int64_t{1} << role;
  }
  // The largest team for which there is room and work enough.
  const auto terms = [&](int64_t team) {
    int64_t sum = 0;
    for (int role = 0; role < kRoles; ++role) {
      const std::vector<int64_t>& begin = slots_.table(static_cast<Role>(role)).begin;
      int64_t most = 0;
      for (size_t g = 0; g < groups; ++g) most = std::max(most, begin[g + 1] - begin[g]);
      sum += (most * team * kVbdLanes + 31) / 32 * 32;
    }
    return sum;
  };
  if (terms(1) <= kVbdTeamTerms) t->team = 1;
  if (terms(kVbdLargeTeam) <= kVbdTeamTerms && t->most_groups >= kManyTeams * kVbdLargeTeam)
    t->team = kVbdLargeTeam;
  for (const auto& [role, number, activated] :
       {std::tuple(kTriangle, size_t{6}, &t->triangle),
        std::tuple(kTetrahedron, size_t{11}, &t->tetrahedron)}) {
    const ColorSlots::Table& table = slots_.table(role);
    std::vector<int32_t> element;
    std::vector<float> alpha;
    for (size_t k = 0; k < table.sources.size(); ++k) {
      element.push_back(table.sources[k].element);
      alpha.push_back(
          table.floats[(k / lanes * static_cast<size_t>(kFloats[role]) + number) * lanes +
                       k % lanes]);
    }
    *activated = {upload<int32_t>(element, device), upload<float>(alpha, device)};
  }
  forget_tables();
  tables_ = std::move(t);
}

void LaunchedStep::reserve_contacts(int32_t slots) {
  const auto count = static_cast<size_t>(slots);
  if (contact_items_.rows() >= count && contact_begin_.rows() != 0) return;
  const Device device = model_.device();
  contact_begin_ = DeviceArray<int32_t>(static_cast<size_t>(model_.particle_count()) + 1, device);
  contact_items_ = DeviceArray<int32_t>(count, device);
  contact_numbers_ = DeviceArray<float>(count * kContactFloats, device);
  forget_tables();
}

void LaunchedStep::update(float dt) {
  check_numbers(model_);
  const Unobserved unobserved;
  edited_.check(model_);
  for (size_t k = 0; k < mesh_.size(); ++k)
    require(mesh_stamps_[k].matches(*mesh_[k]), ErrorKind::Value, kName,
            ": model: the indices of elements, colours or worlds were edited after the solver was "
            "made; make a new one");
  for (size_t k = 0; k < values_.size(); ++k)
    if (!value_stamps_[k].matches(*values_[k])) {
      build_slots();
      break;
    }
  if (tables_ == nullptr || tables_->dt != dt) build_tables(dt);
}

VbdSweepArguments LaunchedStep::sweep_arguments(bool with_contacts, int64_t first_group,
                                                int64_t end_group) const {
  const Tables& t = *tables_;
  return {.particle = t.particle,
          .filled = t.filled,
          .mass_by_h2 = t.mass_by_h2,
          .begin = t.begin,
          .ints = t.ints,
          .floats = t.floats,
          .contact_begin = with_contacts ? &contact_begin_ : nullptr,
          .contacts = with_contacts ? &contact_numbers_ : nullptr,
          .start = start_,
          .target = target_,
          .moved = moved_,
          .x = x_,
          .to = t.has_conflicts ? next_ : x_,
          .regularization = options_.lhs_regularization,
          .slip = options_.friction_epsilon * t.dt,
          .lanes = slots_.lanes(),
          .damped = damps_ ? (int64_t{1} << kRoles) - 1 : t.damped,
          .first_group = first_group,
          .end_group = end_group,
          .team = t.team,
          .residual = of_particles_};
}

LaunchedStep::Mover LaunchedStep::mover() const {
  const char* const variable = std::getenv("NOVAPHY_VBD_SWEEP");
  const std::string_view wanted = variable != nullptr ? variable : "";
  require(wanted.empty() || wanted == "thread" || wanted == "team", ErrorKind::Value,
          "NOVAPHY_VBD_SWEEP: expected thread or team, got '", wanted, "'");
  const bool by_thread = on_cpu_ || options_.safeguard || tables_->team == 0 || wanted == "thread";
  return by_thread ? Mover::Thread : Mover::Team;
}

void LaunchedStep::activate(const Activated& to, Role role,
                            const DeviceArray<float>& activation) const {
  const auto rows = static_cast<int64_t>(to.element.rows());
  if (rows == 0) return;
  novaphy::run(kernels().activation, rows,
               {.element = to.element,
                .alpha = to.alpha,
                .particle_tri_activation = role == kTriangle ? &activation : nullptr,
                .particle_tet_activation = role == kTetrahedron ? &activation : nullptr,
                .floats = tables_->floats[role],
                .lanes = slots_.lanes(),
                .width = int{kFloats[role]},
                .number = role == kTriangle ? 6 : 11});
}

void LaunchedStep::find_contacts(const Contacts& c) const {
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

void LaunchedStep::commit(int64_t first_group, int64_t end_group,
                          const DeviceArray<Vec4f>& from) const {
  const auto lanes = static_cast<int64_t>(slots_.lanes());
  novaphy::run(
      step_kernels().commit, (end_group - first_group) * lanes,
      {.particle = tables_->particle, .first_lane = first_group * lanes, .from = from, .x = x_});
}

VbdTableArguments tables_of(const Model& m) {
  return {.particle_spring_stiffness = m.particle_spring_stiffness,
          .particle_spring_damping = m.particle_spring_damping,
          .particle_spring_rest_length = m.particle_spring_rest_length,
          .particle_tri_pose = m.particle_tri_pose,
          .particle_tri_area = m.particle_tri_area,
          .particle_tri_material = m.particle_tri_material,
          .particle_edge_rest_angle = m.particle_edge_rest_angle,
          .particle_edge_rest_length = m.particle_edge_rest_length,
          .particle_edge_material = m.particle_edge_material,
          .particle_tet_pose = m.particle_tet_pose,
          .particle_tet_material = m.particle_tet_material,
          .particle_mass = m.particle_mass,
          .particle_flags = m.particle_flags,
          .particle_spring_control = m.particle_spring_control};
}

VbdFinishArguments LaunchedStep::finish_arguments(const VbdLaunchResults& out) const {
  return {.start = start_, .x = x_, .h = tables_->dt, .q = out.q, .qd = out.qd, .faults = faults_};
}

StepArguments LaunchedStep::arguments(const VbdLaunchInputs& in,
                                      const VbdLaunchResults& out) const {
  const Model& m = model_;
  return {.predict = {.particle_q = in.q,
                      .particle_qd = in.qd,
                      .particle_f = in.f,
                      .particle_inv_mass = m.particle_inv_mass,
                      .world = m.particle_world,
                      .gravity = m.gravity,
                      .last_world = m.world_count() - 1,
                      .is_held = is_held_,
                      .h = tables_->dt,
                      .guess = static_cast<int64_t>(options_.initial_guess),
                      .last_velocity = in.last_velocity,
                      .next_last_velocity = out.updates_last ? &in.last_velocity : nullptr,
                      .start = start_,
                      .target = target_,
                      .moved = moved_,
                      .x = x_,
                      .newer = newer_,
                      .faults = faults_,
                      .tables = tables_of(m)},
          .sweep = sweep_arguments(in.have_contacts(), 0, 0),
          .newer = newer_,
          .older = older_,
          .finish = finish_arguments(out)};
}

StepList LaunchedStep::make_list(const StepArguments& arguments, Mover how,
                                 std::span<const DeviceArray<Vec4f>> iterates) const {
  std::vector<WritesRow<VbdRow>> kept;
  for (const DeviceArray<Vec4f>& rows : iterates) kept.emplace_back(rows);
  return StepList({.device = model_.device(),
                   .particles = model_.particle_count(),
                   .lanes = slots_.lanes(),
                   .colors = tables_->colors,
                   .has_conflicts = tables_->has_conflicts,
                   .safeguard = options_.safeguard,
                   .team = how == Mover::Team ? tables_->team : 0,
                   .iterations = options_.iterations,
                   .chebyshev = chebyshev_},
                  arguments, kept);
}

// That of a step that keeps no iterates is kept.
StepList& LaunchedStep::list_for(const StepArguments& arguments, bool with_contacts) {
  const Mover how = mover();
  if (how != list_mover_ || damps_ != list_damps_)
    for (std::optional<StepList>& list : lists_) list.reset();
  list_mover_ = how;
  list_damps_ = damps_;
  std::optional<StepList>& list = lists_[with_contacts ? 1 : 0];
  if (!list) {
    list.emplace(make_list(arguments, how, {}));
  } else {
    list->set(arguments.predict);
    list->set(arguments.finish);
  }
  return *list;
}

void LaunchedStep::run(const VbdLaunchInputs& in, const VbdLaunchResults& out,
                       const std::shared_ptr<ExclusiveUse>& in_use) {
  const Contacts* const contacts = in.contacts;
  const bool with_contacts = in.have_contacts();
  if (with_contacts && contact_items_.rows() < static_cast<size_t>(contacts->soft_contact_max())) {
    const Unobserved unobserved;
    const float dt = tables_->dt;
    reserve_contacts(contacts->soft_contact_max());
    build_tables(dt);
  }
  if (LaunchRecorder* recorder = launch_recorder()) recorder->uses(in_use);
  model_.depend_on_numbers();
  depend_on(std::span<const Array* const>(mesh_));
  constexpr size_t kOfElements = 11;  // the first of values_
  depend_on(std::span<const Array* const>(values_).subspan(in.trains_elements ? kOfElements : 0));
  const StepArguments a = arguments(in, out);
  std::optional<StepList> keeping;  // iterates
  if (!out.iterates.empty()) keeping.emplace(make_list(a, mover(), out.iterates));
  const StepList& list = keeping ? *keeping : list_for(a, with_contacts);
  list.predict();
  if (in.trains_elements) {
    reserve_training();
    put_numbers(in);
  } else {
    activate(tables_->triangle, kTriangle, in.tri_activation);
    activate(tables_->tetrahedron, kTetrahedron, in.tet_activation);
  }
  if (with_contacts) find_contacts(*contacts);
  list.prepare();
  if (in.targets.rows() != 0)
    novaphy::run(kernels().target, held_count(), {.held = held_, .targets = in.targets, .x = x_});
  list.iterate(0, static_cast<size_t>(options_.iterations));
  iterations_run_ = options_.iterations;
  list.finish();
  has_stepped_ = true;
  had_contacts_ = with_contacts;
}

void LaunchedStep::finish(const VbdLaunchResults& out) const {
  novaphy::run(step_kernels().finish, model_.particle_count(), finish_arguments(out));
}

void LaunchedStep::check() {
  const Unobserved unobserved;
  check_trained();
  const std::vector<int32_t> faults = faults_.to_host(), overflow = overflow_.to_host();
  const auto first_of = [&faults](auto&& is_kind) {
    return std::find_if(faults.begin(), faults.end(), is_kind);
  };
  // Where a step reads what is not finite, that is why others are not.
  auto found = first_of([](int32_t fault) { return fault != kNoFault && fault != kFaultResult; });
  if (found == faults.end()) found = first_of([](int32_t fault) { return fault != kNoFault; });
  if (found == faults.end() && overflow[0] == 0) return;
  faults_.zero();
  overflow_.zero();
  constexpr const char* kSince = ": a step on a device, or a replay, since this was last asked: ";
  require(overflow[0] == 0, ErrorKind::Runtime, kName, kSince, "contacts: ", overflow[0],
          " were found, but there are slots for ", overflow[1],
          "; make a pipeline with a larger soft_contact_max");
  static constexpr const char* kWhat[] = {"",
                                          "state_in.particle_q: expected finite numbers",
                                          "state_in.particle_qd: expected finite numbers",
                                          "state_in.particle_f: expected finite numbers",
                                          "state_in: the inertial target overflows float32",
                                          "its position did not stay finite"};
  fail(ErrorKind::Runtime, kName, kSince, "particle ", found - faults.begin(), ": ", kWhat[*found],
       "; its results are NaN");
}

// After a run that kept no iterates: one more iteration.
void LaunchedStep::iterate_again(bool with_contacts) {
  lists_[with_contacts ? 1 : 0]->move_again();
  ++iterations_run_;
}

void LaunchedStep::find_residuals(bool with_contacts) {
  const int64_t groups = tables_->colors.back();
  novaphy::run(step_kernels().clear, static_cast<int64_t>(of_particles_.rows()),
               {.values = of_particles_});
  novaphy::run(step_kernels().residual, groups * slots_.lanes(),
               sweep_arguments(with_contacts, 0, groups));
}

VbdResidual LaunchedStep::residual() {
  find_residuals(had_contacts_);
  return last_residual();
}

// Of what find_residuals found.
VbdResidual LaunchedStep::last_residual() const {
  const std::vector<float> numbers = of_particles_.to_host();
  return sum_residuals(
      std::span(reinterpret_cast<const ParticleResidual*>(numbers.data()), numbers.size() / 3),
      iterations_run_);
}

}  // namespace novaphy::vbd
