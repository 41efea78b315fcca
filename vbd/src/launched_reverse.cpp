#include "launched_reverse.h"

#include "novaphy/core/builtin_kernels.h"
#include "vbd_adjoint_kernels.h"
#include "vbd_gradient_kernels.h"

namespace novaphy::detail {
const char* vbd_adjoint_kernels_text();
const char* vbd_gradient_kernels_text();
}  // namespace novaphy::detail

namespace novaphy::vbd {
namespace {

// Never destroyed: recordings refer to them.
struct Kernels {
#define NOVAPHY_VBD_KERNEL(name) \
  Kernel<VbdAdjointArguments> name{vbd_##name, detail::vbd_adjoint_kernels_text};
  NOVAPHY_VBD_KERNEL(adjoint_solve)
  NOVAPHY_VBD_KERNEL(adjoint_solve_team)
  NOVAPHY_VBD_KERNEL(adjoint_slots)
  NOVAPHY_VBD_KERNEL(adjoint_weights)
  NOVAPHY_VBD_KERNEL(adjoint_rest)
  NOVAPHY_VBD_KERNEL(adjoint_rest_weights)
  NOVAPHY_VBD_KERNEL(adjoint_start)
  NOVAPHY_VBD_KERNEL(adjoint_start_weights)
#undef NOVAPHY_VBD_KERNEL
#define NOVAPHY_VBD_KERNEL(name) \
  Kernel<decltype(vbd_##name)::Arguments> name{vbd_##name, detail::vbd_gradient_kernels_text};
  NOVAPHY_VBD_KERNEL(clear)
  NOVAPHY_VBD_KERNEL(adjoint_begin)
  NOVAPHY_VBD_KERNEL(adjoint_end)
  NOVAPHY_VBD_KERNEL(receive)
  NOVAPHY_VBD_KERNEL(particle_gradient)
  NOVAPHY_VBD_KERNEL(target_gradient)
  NOVAPHY_VBD_KERNEL(gravity_gradient)
  NOVAPHY_VBD_KERNEL(spring_gradient)
  NOVAPHY_VBD_KERNEL(edge_gradient)
  NOVAPHY_VBD_KERNEL(triangle_gradient)
  NOVAPHY_VBD_KERNEL(tetrahedron_gradient)
  NOVAPHY_VBD_KERNEL(radius_gradient)
  NOVAPHY_VBD_KERNEL(contact_shape)
  NOVAPHY_VBD_KERNEL(shape_gradient)
#undef NOVAPHY_VBD_KERNEL
};
const Kernels& kernels() {
  static const auto& all = *new Kernels;
  return all;
}

bool any(std::initializer_list<const Array*> arrays) {
  for (const Array* array : arrays)
    if (array->rows() != 0) return true;
  return false;
}

}  // namespace

void LaunchedReverse::build_tables() {
  const ColorSlots& slots = step_.slots_;
  const Device device = step_.model_.device();
  const auto lanes = static_cast<size_t>(slots.lanes());
  Receivers r;
  r.build(slots, step_.model_.particle_count(), true);
  Tables t;
  t.builds = step_.builds_;
  t.color_begin = r.color_begin;
  t.particle = upload<int32_t>(r.particle, device);
  t.is_own = upload<int32_t>(r.is_own, device);
  t.begin = upload<uint64_t>(r.begin, device);
  t.others = upload<uint64_t>(r.others, device);
  t.entries = upload<uint64_t>(r.entries, device);
  t.numbers_begin.assign(1, 0);
  std::vector<int64_t> begins;
  std::vector<int32_t> particle;
  Sweep sweep;
  slots.fill(sweep);
  for (int role = 0; role < kRoles; ++role) {
    const ColorSlots::Table& table = slots.table(static_cast<Role>(role));
    t.numbers_begin.push_back(t.numbers_begin.back() + static_cast<int64_t>(table.floats.size()));
    t.slots[role] = table.begin;
    const size_t before = particle.size();
    begins.push_back(static_cast<int64_t>(before));
    particle.resize(before + table.sources.size(), -1);
    for (size_t g = 0; g + 1 < table.begin.size(); ++g)
      for (auto s = static_cast<size_t>(table.begin[g]);
           s < static_cast<size_t>(table.begin[g + 1]); ++s)
        for (size_t lane = 0; lane < lanes; ++lane)
          if (table.sources[s * lanes + lane].element >= 0)
            particle[before + s * lanes + lane] = sweep.particle[g * lanes + lane];
    t.places[role] = upload<uint64_t>(table.places, device);
  }
  t.slot_particle = upload<int32_t>(particle, device);
  begins.insert(begins.end(), r.terms_begin.begin(), r.terms_begin.begin() + kRoles);
  begins.insert(begins.end(), t.numbers_begin.begin(), t.numbers_begin.begin() + kRoles);
  t.begins = upload<uint64_t>(begins, device);
  const IndexRows worlds = particles_of_worlds(step_.on_cpu_ ? step_.model_ : *step_.copy_);
  t.world_begin = upload<int32_t>(worlds.begins().data(), worlds.begins().size(), device);
  t.of_worlds = upload<int32_t>(worlds.all().data(), worlds.all().size(), device);
  tables_ = std::move(t);
  terms_ = DeviceArray<float>(static_cast<size_t>(r.terms_begin.back()), device);
  numbers_ = DeviceArray<float>(static_cast<size_t>(tables_.numbers_begin.back()), device);
}

// `iterates`: how many the step keeps.
void LaunchedReverse::reserve(int32_t iterates) {
  const Unobserved unobserved;
  const Model& m = step_.model_;
  const Device device = m.device();
  const auto n = static_cast<size_t>(m.particle_count());
  if (tables_.builds != step_.builds_) build_tables();
  if (x_bar_.rows() != n) {
    for (DeviceArray<Vec4f>* rows :
         {&x_bar_, &u_, &d_, &own_, &start_bar_, &target_bar_, &gravity_bar_})
      *rows = DeviceArray<Vec4f>(n, device);
    mass_bar_ = DeviceArray<float>(n, device);
    q_out_ = DeviceArray<Vec3f>(n, device);
    qd_out_ = DeviceArray<Vec3f>(n, device);
    iterates_.clear();
    for (int32_t k = 0; k < iterates; ++k) iterates_.emplace_back(n, device);
  }
}

// As many as the step has room for.
void LaunchedReverse::reserve_contacts() {
  const Unobserved unobserved;
  const Device device = step_.model_.device();
  const size_t contacts = step_.contact_items_.rows();
  if (contact_bars_.rows() == contacts * kContactLawFloats) return;
  contact_bars_ = DeviceArray<float>(contacts * kContactLawFloats, device);
  shape_of_contact_ = DeviceArray<int32_t>(contacts, device);
  of_shapes_ = DeviceArray<int32_t>(contacts, device);
  shape_begin_ = DeviceArray<int32_t>(static_cast<size_t>(step_.model_.shape_count()) + 1, device);
}

void LaunchedReverse::clear(const Array& values) const {
  novaphy::run(kernels().clear, static_cast<int64_t>(values.bytes() / sizeof(float)),
               {.values = Untyped(values)});
}

// Of the groups [first, end).
VbdAdjointArguments LaunchedReverse::arguments(bool with_contacts, const Rows4* before,
                                               int64_t first, int64_t end,
                                               const AtRest* rest) const {
  int64_t first_lanes[kRoles], ends[kRoles], threads = 0;
  for (size_t role = 0; role < kRoles; ++role) {
    const std::vector<int64_t>& slots = tables_.slots[role];
    const int64_t begin = slots[static_cast<size_t>(first)];
    first_lanes[role] = begin * kVbdLanes;
    threads += (slots[static_cast<size_t>(end)] - begin) * kVbdLanes;
    ends[role] = threads;
  }
  return {.sweep = step_.sweep_arguments(with_contacts, first, end),
          .before = before,
          .x_bar = x_bar_,
          .u = u_,
          .d = d_,
          .own = own_,
          .start_bar = start_bar_,
          .target_bar = target_bar_,
          .mass_bar = mass_bar_,
          .contact_bars = with_contacts ? &contact_bars_ : nullptr,
          .at_rest = int{rest != nullptr},
          .multiplier = rest != nullptr ? rest->multipliers : nullptr,
          .multiplier_sum = rest != nullptr ? rest->sum : nullptr,
          .slot_particle = tables_.slot_particle,
          .terms = terms_,
          .numbers = numbers_,
          .begins = tables_.begins,
          .first = first_lanes,
          .ends = ends};
}

void LaunchedReverse::receive(size_t color, const Rows4* own, const Rows4& rows,
                              int64_t parts) const {
  const Tables& t = tables_;
  novaphy::run(kernels().receive, t.color_begin[color + 1] - t.color_begin[color],
               {.particle = t.particle,
                .begin = t.begin,
                .others = t.others,
                .entries = t.entries,
                .first = t.color_begin[color],
                .lanes = kVbdLanes,
                .terms = terms_,
                .is_own = t.is_own,
                .own = own,
                .rows = rows,
                .parts = parts});
}

// Back through the step of the groups [first, end), up to what particles get.
void LaunchedReverse::reverse_groups(bool with_contacts, bool weights, const Rows4* before,
                                     int64_t first, int64_t end, const AtRest* rest) const {
  const VbdAdjointArguments a = arguments(with_contacts, before, first, end, rest);
  const bool by_threads = step_.mover() == LaunchedStep::Mover::Thread ||
                          (rest != nullptr && rest->multipliers != nullptr);
  const int64_t groups = end - first;
  novaphy::run(by_threads ? kernels().adjoint_solve : kernels().adjoint_solve_team,
               by_threads ? groups * kVbdLanes : team_threads(groups, step_.tables_->team), a);
  novaphy::run(rest != nullptr ? (weights ? kernels().adjoint_rest_weights : kernels().adjoint_rest)
                               : (weights ? kernels().adjoint_weights : kernels().adjoint_slots),
               a.ends[kRoles - 1], a);
}

void LaunchedReverse::reverse_colors(bool with_contacts, bool weights) const {
  const std::vector<int64_t>& colors = step_.tables_->colors;
  const bool has_conflicts = step_.tables_->has_conflicts;
  for (size_t k = iterates_.size(); k-- > 0;)
    for (size_t color = colors.size() - 1; color-- > 0;) {
      const int64_t first = colors[color], end = colors[color + 1];
      if (has_conflicts) step_.commit(first, end, iterates_[k]);
      reverse_groups(with_contacts, weights, has_conflicts ? nullptr : &iterates_[k], first, end,
                     nullptr);
      receive(color, &own_, x_bar_);
    }
}

// `guess`: the bars of what iterations began with; null: of nothing.
void LaunchedReverse::end(bool with_contacts, bool weights, const Rows4* guess,
                          const Array& qd_bar) const {
  novaphy::run(kernels().adjoint_end, step_.model_.particle_count(),
               {.is_held = step_.is_held_,
                .x_bar = x_bar_,
                .guess = guess,
                .qd_bar = Untyped(qd_bar),
                .inverse_h = 1.0f / step_.tables_->dt,
                .start_bar = start_bar_});
  const std::vector<int64_t>& colors = step_.tables_->colors;
  const VbdAdjointArguments a = arguments(with_contacts, nullptr, 0, colors.back(), nullptr);
  novaphy::run(weights ? kernels().adjoint_start_weights : kernels().adjoint_start,
               a.ends[kRoles - 1], a);
  for (size_t color = 0; color + 1 < colors.size(); ++color) receive(color, nullptr, start_bar_);
}

void LaunchedReverse::clear_parameters(bool with_contacts) const {
  for (const Array* rows :
       std::initializer_list<const Array*>{&start_bar_, &target_bar_, &mass_bar_, &numbers_})
    clear(*rows);
  if (with_contacts) clear(contact_bars_);
}

// From the bars of the results, after the step ran.
void LaunchedReverse::begin(bool with_contacts, const Array& q_bar, const Array& qd_bar) {
  if (with_contacts) reserve_contacts();
  clear_parameters(with_contacts);
  novaphy::run(kernels().adjoint_begin, step_.model_.particle_count(),
               {.q_bar = Untyped(q_bar),
                .qd_bar = Untyped(qd_bar),
                .inverse_h = 1.0f / step_.tables_->dt,
                .x_bar = x_bar_});
}

void LaunchedReverse::run(const VbdLaunchInputs& in, const Array& q_bar, const Array& qd_bar,
                          const VbdStepArrays& g, const std::shared_ptr<ExclusiveUse>& in_use) {
  const bool with_contacts = in.have_contacts();
  reserve(step_.options_.iterations);
  step_.run(in, {q_out_, qd_out_, iterates_}, in_use);
  step_.find_residuals(with_contacts);
  begin(with_contacts, q_bar, qd_bar);
  const bool weights = wants_weights(g);
  reverse_colors(with_contacts, weights);
  const bool from_start = step_.options_.initial_guess == VbdInitialGuess::Previous;
  const Rows4* const guess = from_start ? &start_bar_ : &target_bar_;
  end(with_contacts, weights, in.last_velocity.rows() != 0 ? nullptr : guess, qd_bar);
  put(in, g, false);
}

bool LaunchedReverse::wants_weights(const VbdStepArrays& g) {
  return any({&g.particle_tri_pose, &g.particle_tet_pose});
}
void LaunchedReverse::put(const VbdLaunchInputs& in, const VbdStepArrays& g, bool at_solution) {
  put_state(in, g, at_solution);
  put_elements(g);
  put_contacts(in, g);
}

void LaunchedReverse::put_state(const VbdLaunchInputs& in, const VbdStepArrays& g,
                                bool at_solution) const {
  const Model& m = step_.model_;
  const bool guessed = !at_solution && in.last_velocity.rows() != 0;
  if (any({&g.particle_q, &g.particle_qd, &g.particle_f, &g.particle_mass, &g.gravity,
           &g.last_velocity}))
    novaphy::run(kernels().particle_gradient, m.particle_count(),
                 {.is_held = step_.is_held_,
                  .inv_mass = m.particle_inv_mass,
                  .f = in.f,
                  .x_bar = x_bar_,
                  .start_bar = start_bar_,
                  .target_bar = target_bar_,
                  .mass_bar = mass_bar_,
                  .h = step_.tables_->dt,
                  .have_targets = int{in.targets.rows() != 0},
                  .by_q = Untyped(g.particle_q),
                  .by_qd = Untyped(g.particle_qd),
                  .by_f = Untyped(g.particle_f),
                  .by_mass = Untyped(g.particle_mass),
                  .by_gravity = any({&g.gravity}) ? &gravity_bar_ : nullptr,
                  .by_last = Untyped(g.last_velocity),
                  .last = guessed ? &in.last_velocity : nullptr,
                  .qd = in.qd,
                  .world = m.particle_world,
                  .gravity = m.gravity,
                  .last_world = m.world_count() - 1});
  if (any({&g.targets}))
    novaphy::run(kernels().target_gradient, step_.held_count(),
                 {.held = step_.held_, .x_bar = x_bar_, .by_targets = Untyped(g.targets)});
  if (any({&g.gravity}))
    novaphy::run(kernels().gravity_gradient, m.world_count(),
                 {.begin = tables_.world_begin,
                  .particles = tables_.of_worlds,
                  .of_particles = gravity_bar_,
                  .by_gravity = Untyped(g.gravity)});
}

VbdLawArguments LaunchedReverse::law_bars(Role role) const {
  return {.places = tables_.places[role],
          .numbers = numbers_,
          .first = tables_.numbers_begin[role],
          .lanes = kVbdLanes};
}

void LaunchedReverse::put_elements(const VbdStepArrays& g) const {
  const Model& m = step_.model_;
  const float h = step_.tables_->dt;
  const auto rows = [](const Array& elements) { return static_cast<int64_t>(elements.rows()); };
  if (any({&g.particle_spring_stiffness, &g.particle_spring_damping,
           &g.particle_spring_rest_length}))
    novaphy::run(kernels().spring_gradient, rows(m.particle_spring_indices),
                 {.bars = law_bars(kSpring),
                  .h = h,
                  .by_stiffness = Untyped(g.particle_spring_stiffness),
                  .by_damping = Untyped(g.particle_spring_damping),
                  .by_rest_length = Untyped(g.particle_spring_rest_length)});
  if (any({&g.particle_tri_material, &g.particle_tri_activation, &g.particle_tri_area,
           &g.particle_tri_pose}))
    novaphy::run(kernels().triangle_gradient, rows(m.particle_tri_indices),
                 {.bars = law_bars(kTriangle),
                  .area = m.particle_tri_area,
                  .material = m.particle_tri_material,
                  .h = h,
                  .by_material = Untyped(g.particle_tri_material),
                  .by_activation = Untyped(g.particle_tri_activation),
                  .by_area = Untyped(g.particle_tri_area),
                  .by_pose = Untyped(g.particle_tri_pose)});
  if (any({&g.particle_edge_material, &g.particle_edge_rest_angle, &g.particle_edge_rest_length}))
    novaphy::run(kernels().edge_gradient, rows(m.particle_edge_indices),
                 {.opposite = law_bars(kHingeOpposite),
                  .end = law_bars(kHingeEnd),
                  .material = m.particle_edge_material,
                  .rest_length = m.particle_edge_rest_length,
                  .h = h,
                  .by_material = Untyped(g.particle_edge_material),
                  .by_rest_angle = Untyped(g.particle_edge_rest_angle),
                  .by_rest_length = Untyped(g.particle_edge_rest_length)});
  if (any({&g.particle_tet_material, &g.particle_tet_activation, &g.particle_tet_pose}))
    novaphy::run(kernels().tetrahedron_gradient, rows(m.particle_tet_indices),
                 {.bars = law_bars(kTetrahedron),
                  .pose = m.particle_tet_pose,
                  .material = m.particle_tet_material,
                  .h = h,
                  .by_material = Untyped(g.particle_tet_material),
                  .by_activation = Untyped(g.particle_tet_activation),
                  .by_pose = Untyped(g.particle_tet_pose)});
}

void LaunchedReverse::put_contacts(const VbdLaunchInputs& in, const VbdStepArrays& g) {
  const Model& m = step_.model_;
  const bool with_contacts = in.have_contacts();
  if (any({&g.particle_radius}))
    novaphy::run(kernels().radius_gradient, m.particle_count(),
                 {.contact_begin = with_contacts ? &step_.contact_begin_ : nullptr,
                  .contact_bars = with_contacts ? &contact_bars_ : nullptr,
                  .by_radius = Untyped(g.particle_radius)});
  if (!any({&g.shape_margin, &g.shape_material_ke, &g.shape_material_kd, &g.shape_material_mu}))
    return;
  if (with_contacts) {
    const auto contacts = static_cast<int64_t>(in.contacts->soft_contact_max());
    novaphy::run(kernels().contact_shape, contacts,
                 {.begin = step_.contact_begin_,
                  .items = step_.contact_items_,
                  .particles = m.particle_count(),
                  .shape = in.contacts->soft_contact_shape,
                  .shape_of_contact = shape_of_contact_});
    novaphy::run(incidence(), m.shape_count(),
                 {.table = shape_of_contact_,
                  .slots = contacts,
                  .offsets = shape_begin_,
                  .items = of_shapes_});
  }
  novaphy::run(kernels().shape_gradient, m.shape_count(),
               {.begin = with_contacts ? &shape_begin_ : nullptr,
                .contacts = with_contacts ? &of_shapes_ : nullptr,
                .contact_bars = with_contacts ? &contact_bars_ : nullptr,
                .mu = m.shape_material_mu,
                .model_mu = m.soft_contact_mu,
                .h = step_.tables_->dt,
                .by_margin = Untyped(g.shape_margin),
                .by_ke = Untyped(g.shape_material_ke),
                .by_kd = Untyped(g.shape_material_kd),
                .by_mu = Untyped(g.shape_material_mu)});
}

}  // namespace novaphy::vbd
