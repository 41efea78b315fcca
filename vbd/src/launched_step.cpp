#include "launched_step.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <string_view>
#include <utility>

#include "novaphy/core/assert.h"
#include "novaphy/core/error.h"
#include "step_options.h"
#include "vbd_gradient_kernels.h"
#include "vbd_kernels.h"

namespace novaphy::detail {
const char* vbd_kernels_text();
const char* vbd_gradient_kernels_text();
}  // namespace novaphy::detail

namespace novaphy::vbd {
namespace {

constexpr const char* kName = "SolverVBD.step";

// The same on the CPU, a row for each group.
struct GroupArguments {
  VbdSweepArguments of_devices;
  const Sweep* sweep;
  const SweepLevel* level;
};
template <class Function>
void for_groups(const uint64_t* words, int64_t begin, int64_t end, const Function& function) {
  GroupArguments a;
  std::memcpy(&a, words, sizeof(a));
  for (int64_t row = begin; row < end; ++row) function(a, *a.level, a.of_devices.first_group + row);
}
void prepare_rows(const uint64_t* words, int64_t, int64_t begin, int64_t end) {
  for_groups(words, begin, end, [](const GroupArguments& a, const SweepLevel& level, int64_t g) {
    level.prepare(*a.sweep, g);
  });
}
void move_rows(const uint64_t* words, int64_t, int64_t begin, int64_t end) {
  for_groups(words, begin, end, [](const GroupArguments& a, const SweepLevel& level, int64_t g) {
    level.move(*a.sweep, g);
  });
}
void residual_rows(const uint64_t* words, int64_t, int64_t begin, int64_t end) {
  for_groups(words, begin, end, [](const GroupArguments& a, const SweepLevel& level, int64_t g) {
    level.residual(*a.sweep, g, reinterpret_cast<ParticleResidual*>(a.of_devices.residual));
  });
}
constexpr uint32_t kGroupWords = sizeof(GroupArguments) / sizeof(uint64_t);
constexpr novaphy_row_function group_kernel(const char* name, void (*rows)(const uint64_t*, int64_t,
                                                                           int64_t, int64_t)) {
  return {sizeof(novaphy_row_function), name, kGroupWords, 0, rows};
}
constexpr novaphy_row_function kPrepareGroups = group_kernel("vbd_prepare_groups", prepare_rows),
                               kMoveGroups = group_kernel("vbd_move_groups", move_rows),
                               kResidualGroups = group_kernel("vbd_residual_groups", residual_rows);

// Never destroyed: recordings refer to them.
struct Kernels {
#define NOVAPHY_VBD_KERNEL(name) DeviceKernel name{vbd_##name, detail::vbd_kernels_text};
  NOVAPHY_VBD_KERNEL(predict)
  NOVAPHY_VBD_KERNEL(target)
  NOVAPHY_VBD_KERNEL(activation)
  NOVAPHY_VBD_KERNEL(contact)
  NOVAPHY_VBD_KERNEL(prepare)
  NOVAPHY_VBD_KERNEL(move)
  NOVAPHY_VBD_KERNEL(move_guarded)
  NOVAPHY_VBD_KERNEL(move_team)
  NOVAPHY_VBD_KERNEL(commit)
  NOVAPHY_VBD_KERNEL(accelerate)
  NOVAPHY_VBD_KERNEL(finish)
  NOVAPHY_VBD_KERNEL(residual)
#undef NOVAPHY_VBD_KERNEL
  DeviceKernel clear{vbd_clear, detail::vbd_gradient_kernels_text};
  DeviceKernel keep{vbd_keep, detail::vbd_gradient_kernels_text};
  DeviceKernel prepare_groups{kPrepareGroups, nullptr};
  DeviceKernel move_groups{kMoveGroups, nullptr};
  DeviceKernel residual_groups{kResidualGroups, nullptr};
  DeviceKernel incidence{"incidence_i32"};
};
const Kernels& kernels() {
  static const auto& all = *new Kernels;
  return all;
}

bool has_code_for(Device device) {
  return device.type == DeviceType::CUDA ? NOVAPHY_VBD_CUDA : NOVAPHY_VBD_DLAN;
}

constexpr int64_t kTeamThreads = 128;
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
  tables_ = nullptr;
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
  if (on_cpu_) {
    Sweep sweeps[2];
    for (int with = 0; with < 2; ++with) {
      Sweep& s = sweeps[with];
      s.particle = t->particle.data();
      s.filled = t->filled.data();
      s.mass_by_h2 = t->mass_by_h2.data();
      for (int role = 0; role < kRoles; ++role)
        s.slots[role] = {reinterpret_cast<const int64_t*>(t->begin[role].data()),
                         t->ints[role].data(), const_cast<float*>(t->floats[role].data()),
                         ((t->damped >> role) & 1) != 0};
      if (with == 1) {
        s.contact_begin = contact_begin_.data();
        s.contacts = contact_numbers_.data();
      }
      const auto rows = [](const DeviceArray<Vec4f>& array) {
        return const_cast<float*>(reinterpret_cast<const float*>(array.data()));
      };
      s.start = rows(start_);
      s.target = rows(target_);
      s.moved = rows(moved_);
      s.x = rows(x_);
      s.step = t->has_conflicts ? rows(next_) : nullptr;
      s.regularization = options_.lhs_regularization;
      s.slip = options_.friction_epsilon * dt;
      s.safeguard = options_.safeguard;
    }
    t->sweeps = upload<uint8_t>(reinterpret_cast<const uint8_t*>(sweeps), sizeof(sweeps), device);
  }
  tables_ = std::move(t);
}

void LaunchedStep::reserve_contacts(int32_t slots) {
  const auto count = static_cast<size_t>(slots);
  if (contact_items_.rows() >= count && contact_begin_.rows() != 0) return;
  const Device device = model_.device();
  contact_begin_ = DeviceArray<int32_t>(static_cast<size_t>(model_.particle_count()) + 1, device);
  contact_items_ = DeviceArray<int32_t>(count, device);
  contact_numbers_ = DeviceArray<float>(count * kContactFloats, device);
  tables_ = nullptr;  // point to them
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

std::vector<LaunchArgument> LaunchedStep::sweep_arguments(bool with_contacts, int64_t first_group,
                                                          int64_t end_group) const {
  const Tables& t = *tables_;
  std::vector<LaunchArgument> a;
  a.reserve(kGroupWords);
  a.push_back(reads("particle", t.particle));
  a.push_back(reads("filled", t.filled));
  a.push_back(reads("mass_by_h2", t.mass_by_h2));
  for (const auto& begin : t.begin) a.push_back(reads("begin", begin));
  for (const auto& ints : t.ints) a.push_back(reads("ints", ints));
  for (const auto& floats : t.floats) a.push_back(updates("floats", floats));
  a.push_back(with_contacts ? reads("contact_begin", contact_begin_) : number(int64_t{0}));
  a.push_back(with_contacts ? reads("contacts", contact_numbers_) : number(int64_t{0}));
  a.push_back(reads("start", start_));
  a.push_back(reads("target", target_));
  a.push_back(updates("moved", moved_));
  a.push_back(updates("x", x_));
  a.push_back(updates("to", t.has_conflicts ? next_ : x_));
  a.push_back(number(options_.lhs_regularization));
  a.push_back(number(options_.friction_epsilon * t.dt));
  a.push_back(number(damps_ ? (int64_t{1} << kRoles) - 1 : t.damped));
  a.push_back(number(first_group));
  a.push_back(number(end_group));
  a.push_back(number(t.team));
  a.push_back(writes("residual", of_particles_));
  if (!on_cpu_) return a;
  LaunchArgument sweep = reads("sweep", t.sweeps);
  sweep.word += with_contacts ? sizeof(Sweep) : 0;
  a.push_back(std::move(sweep));
  a.push_back(number(static_cast<int64_t>(reinterpret_cast<intptr_t>(&level_))));
  return a;
}

// Over some groups: on the CPU a row for each of them, else one for each of their lanes.
void LaunchedStep::launch(const DeviceKernel& on_device, const DeviceKernel& on_cpu, int64_t groups,
                          bool with_contacts, int64_t first_group) const {
  const std::vector<LaunchArgument> arguments =
      sweep_arguments(with_contacts, first_group, first_group + groups);
  const DeviceKernel& kernel = on_cpu_ ? on_cpu : on_device;
  kernel.launch(model_.device(), on_cpu_ ? groups : groups * kVbdLanes, arguments);
}

LaunchedStep::Mover LaunchedStep::mover() const {
  const char* const variable = std::getenv("NOVAPHY_VBD_SWEEP");
  const std::string_view wanted = variable != nullptr ? variable : "";
  require(wanted.empty() || wanted == "thread" || wanted == "team", ErrorKind::Value,
          "NOVAPHY_VBD_SWEEP: expected thread or team, got '", wanted, "'");
  const bool by_thread = on_cpu_ || options_.safeguard || tables_->team == 0 || wanted == "thread";
  return by_thread ? Mover::Thread : Mover::Team;
}

// Of a launch over the teams of some groups.
int64_t LaunchedStep::team_rows(int64_t groups) const {
  return (groups + tables_->team - 1) / tables_->team * kTeamThreads;
}

void LaunchedStep::activate(const Activated& to, Role role,
                            const DeviceArray<float>& activation) const {
  const auto rows = static_cast<int64_t>(to.element.rows());
  if (rows == 0) return;
  kernels().activation.launch(
      model_.device(), rows,
      {reads_row("element", to.element), reads_row("alpha", to.alpha),
       reads(role == kTriangle ? "particle_tri_activation" : "particle_tet_activation", activation),
       updates("floats", tables_->floats[role]), number(int64_t{slots_.lanes()}),
       number(int64_t{kFloats[role]}), number(int64_t{role == kTriangle ? 6 : 11})});
}

void LaunchedStep::find_contacts(const Contacts& c) const {
  const Device device = model_.device();
  const auto particles = static_cast<int64_t>(model_.particle_count());
  kernels().incidence.launch(
      device, particles,
      {reads("soft_contact_particle", c.soft_contact_particle),
       number(int64_t{c.soft_contact_max()}), writes("contact_begin", contact_begin_),
       writes("contact_items", contact_items_)});
  kernels().contact.launch(device, c.soft_contact_max(),
                           {reads("contact_begin", contact_begin_),
                            reads("contact_items", contact_items_),
                            number(particles),
                            reads("soft_contact_count", c.soft_contact_count),
                            updates("overflow", overflow_),
                            reads("soft_contact_particle", c.soft_contact_particle),
                            reads("soft_contact_shape", c.soft_contact_shape),
                            reads("soft_contact_body_pos", c.soft_contact_body_pos),
                            reads("soft_contact_body_vel", c.soft_contact_body_vel),
                            reads("soft_contact_normal", c.soft_contact_normal),
                            reads("particle_radius", model_.particle_radius),
                            reads("shape_margin", model_.shape_margin),
                            reads("shape_material_ke", model_.shape_material_ke),
                            reads("shape_material_kd", model_.shape_material_kd),
                            reads("shape_material_mu", model_.shape_material_mu),
                            number(model_.soft_contact_ke),
                            number(model_.soft_contact_kd),
                            number(model_.soft_contact_mu),
                            number(tables_->dt),
                            writes("contacts", contact_numbers_)});
}

void LaunchedStep::commit(int64_t first_group, int64_t end_group,
                          const DeviceArray<Vec4f>& from) const {
  const auto lanes = static_cast<int64_t>(slots_.lanes());
  kernels().commit.launch(model_.device(), (end_group - first_group) * lanes,
                          {reads("particle", tables_->particle), number(first_group * lanes),
                           reads("from", from), updates("x", x_)});
}

// One iteration; not by all colours in one launch.
void LaunchedStep::iterate_once(bool with_contacts, Mover how) const {
  const Tables& t = *tables_;
  const Device device = model_.device();
  const DeviceKernel& move = how == Mover::Team   ? kernels().move_team
                             : options_.safeguard ? kernels().move_guarded
                                                  : kernels().move;
  for (size_t c = 0; c + 1 < t.colors.size(); ++c) {
    const int64_t first = t.colors[c], groups = t.colors[c + 1] - first;
    if (how == Mover::Team) {
      move.launch(device, team_rows(groups), sweep_arguments(with_contacts, first, first + groups));
    } else {
      launch(move, kernels().move_groups, groups, with_contacts, first);
    }
    if (t.has_conflicts) commit(first, first + groups, next_);
  }
}

void LaunchedStep::iterate(bool with_contacts, std::span<const DeviceArray<Vec4f>> iterates) const {
  const Device device = model_.device();
  const Mover how = mover();
  for (int32_t k = 1; k <= options_.iterations; ++k) {
    if (!iterates.empty())
      kernels().keep.launch(
          device, model_.particle_count(),
          {reads_row("x", x_), writes_row("iterate", iterates[static_cast<size_t>(k - 1)])});
    iterate_once(with_contacts, how);
    if (options_.acceleration)
      kernels().accelerate.launch(
          device, model_.particle_count(),
          {reads_row("is_held", is_held_),
           with_contacts ? reads("contact_begin", contact_begin_) : number(int64_t{0}),
           number(chebyshev_[static_cast<size_t>(k)]), number(int64_t{k}),
           reads_row("start", start_), updates_row("moved", moved_), updates_row("x", x_),
           updates_row("newer", newer_), updates_row("older", older_)});
  }
}

void LaunchedStep::run(const VbdLaunchInputs& in, const VbdLaunchResults& out,
                       const std::shared_ptr<ExclusiveUse>& in_use) {
  const Device device = model_.device();
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
  const auto last = [&] {
    if (in.last_velocity.rows() == 0) return number(int64_t{0});
    return out.updates_last ? updates_row("last_velocity", in.last_velocity)
                            : reads_row("last_velocity", in.last_velocity);
  };
  const auto particles = static_cast<int64_t>(model_.particle_count());
  std::vector<LaunchArgument> predict = {
      reads_row("state_in.particle_q", in.q),
      reads_row("state_in.particle_qd", in.qd),
      reads_row("state_in.particle_f", in.f),
      reads_row("model.particle_inv_mass", model_.particle_inv_mass),
      reads_row("model.particle_world", model_.particle_world),
      reads("model.gravity", model_.gravity),
      number(int64_t{model_.world_count()} - 1),
      reads_row("is_held", is_held_),
      number(tables_->dt),
      number(static_cast<int64_t>(options_.initial_guess)),
      last(),
      number(int64_t{out.updates_last}),
      writes_row("start", start_),
      writes_row("target", target_),
      writes_row("moved", moved_),
      writes_row("x", x_),
      options_.acceleration ? writes_row("newer", newer_) : number(int64_t{0}),
      updates_row("faults", faults_)};
  static constexpr const char* kValueNames[] = {
      "model.particle_spring_stiffness",   "model.particle_spring_damping",
      "model.particle_spring_rest_length", "model.particle_tri_pose",
      "model.particle_tri_area",           "model.particle_tri_material",
      "model.particle_edge_rest_angle",    "model.particle_edge_rest_length",
      "model.particle_edge_material",      "model.particle_tet_pose",
      "model.particle_tet_material",       "model.particle_mass",
      "model.particle_inv_mass",           "model.particle_flags",
      "model.particle_spring_control"};
  for (size_t k = 0; k < values_.size(); ++k) predict.push_back(reads(kValueNames[k], *values_[k]));
  kernels().predict.launch(device, particles, predict);
  if (in.trains_elements) {
    reserve_training();
    put_numbers(in);
  } else {
    activate(tables_->triangle, kTriangle, in.tri_activation);
    activate(tables_->tetrahedron, kTetrahedron, in.tet_activation);
  }
  if (with_contacts) find_contacts(*contacts);
  launch(kernels().prepare, kernels().prepare_groups, tables_->colors.back(), with_contacts, 0);
  if (in.targets.rows() != 0)
    kernels().target.launch(
        device, held_count(),
        {reads_row("held", held_), reads_row("targets", in.targets), updates("x", x_)});
  iterate(with_contacts, out.iterates);
  iterations_run_ = options_.iterations;
  finish(out);
  has_stepped_ = true;
  had_contacts_ = with_contacts;
}

void LaunchedStep::finish(const VbdLaunchResults& out) const {
  kernels().finish.launch(
      model_.device(), model_.particle_count(),
      {reads_row("start", start_), reads_row("x", x_), number(tables_->dt),
       writes_row("state_out.particle_q", out.q), writes_row("state_out.particle_qd", out.qd),
       updates_row("faults", faults_)});
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

// After a run: one more iteration.
void LaunchedStep::iterate_again(bool with_contacts) {
  iterate_once(with_contacts, mover());
  ++iterations_run_;
}

void LaunchedStep::find_residuals(bool with_contacts) {
  kernels().clear.launch(model_.device(), static_cast<int64_t>(of_particles_.rows()),
                         {writes_row("residual", of_particles_)});
  launch(kernels().residual, kernels().residual_groups, tables_->colors.back(), with_contacts, 0);
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
