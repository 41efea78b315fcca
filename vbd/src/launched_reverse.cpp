#include "launched_reverse.h"

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
#define NOVAPHY_VBD_KERNEL(name) DeviceKernel name{vbd_##name, detail::vbd_adjoint_kernels_text};
  NOVAPHY_VBD_KERNEL(adjoint_solve)
  NOVAPHY_VBD_KERNEL(adjoint_solve_team)
  NOVAPHY_VBD_KERNEL(adjoint_slots)
  NOVAPHY_VBD_KERNEL(adjoint_weights)
  NOVAPHY_VBD_KERNEL(adjoint_rest)
  NOVAPHY_VBD_KERNEL(adjoint_rest_weights)
  NOVAPHY_VBD_KERNEL(adjoint_start)
  NOVAPHY_VBD_KERNEL(adjoint_start_weights)
#undef NOVAPHY_VBD_KERNEL
#define NOVAPHY_VBD_KERNEL(name) DeviceKernel name{vbd_##name, detail::vbd_gradient_kernels_text};
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
  DeviceKernel incidence{"incidence_i32"};
};
const Kernels& kernels() {
  static const auto& all = *new Kernels;
  return all;
}

constexpr int64_t kNone = 0;
LaunchArgument read_if(const char* name, const Array& array) {
  return array.rows() != 0 ? reads(name, array) : number(kNone);
}
LaunchArgument write_if(const char* name, const Array& array) {
  return array.rows() != 0 ? writes(name, array) : number(kNone);
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
  kernels().clear.launch(step_.model_.device(),
                         static_cast<int64_t>(values.bytes() / sizeof(float)),
                         {writes("values", values)});
}

// Of the groups [first, end).
std::vector<LaunchArgument> LaunchedReverse::arguments(bool with_contacts, const Array* before,
                                                       int64_t first, int64_t end,
                                                       const AtRest* rest) const {
  std::vector<LaunchArgument> a = step_.sweep_arguments(with_contacts, first, end);
  a.push_back(before != nullptr ? reads("before", *before) : number(kNone));
  a.push_back(reads("x_bar", x_bar_));
  a.push_back(updates("u", u_));
  a.push_back(updates("d", d_));
  a.push_back(updates("own", own_));
  a.push_back(updates("start_bar", start_bar_));
  a.push_back(updates("target_bar", target_bar_));
  a.push_back(updates("mass_bar", mass_bar_));
  a.push_back(with_contacts ? updates("contact_bars", contact_bars_) : number(kNone));
  const auto row_if = [](const Array* rows) {
    return rows != nullptr ? updates("multipliers", *rows) : number(kNone);
  };
  a.push_back(number(int64_t{rest != nullptr}));
  a.push_back(row_if(rest != nullptr ? rest->multipliers : nullptr));
  a.push_back(row_if(rest != nullptr ? rest->sum : nullptr));
  a.push_back(reads("slot_particle", tables_.slot_particle));
  a.push_back(updates("terms", terms_));
  a.push_back(updates("numbers", numbers_));
  a.push_back(reads("begins", tables_.begins));
  int64_t threads = 0;
  std::vector<LaunchArgument> ends;
  for (const std::vector<int64_t>& slots : tables_.slots) {
    const int64_t begin = slots[static_cast<size_t>(first)];
    a.push_back(number(begin * kVbdLanes));
    threads += (slots[static_cast<size_t>(end)] - begin) * kVbdLanes;
    ends.push_back(number(threads));
  }
  a.insert(a.end(), ends.begin(), ends.end());
  return a;
}

void LaunchedReverse::receive(size_t color, const Array* own, const DeviceArray<Vec4f>& rows,
                              int64_t parts) const {
  const Tables& t = tables_;
  kernels().receive.launch(
      step_.model_.device(), t.color_begin[color + 1] - t.color_begin[color],
      {reads("particle", t.particle), reads("begin", t.begin), reads("others", t.others),
       reads("entries", t.entries), number(t.color_begin[color]), number(int64_t{kVbdLanes}),
       reads("terms", terms_), reads("is_own", t.is_own),
       own != nullptr ? reads("own", *own) : number(kNone), updates("rows", rows), number(parts)});
}

// Back through the step of the groups [first, end), up to what particles get.
void LaunchedReverse::reverse_groups(bool with_contacts, bool weights, const Array* before,
                                     int64_t first, int64_t end, const AtRest* rest) const {
  const Device device = step_.model_.device();
  const std::vector<LaunchArgument> a = arguments(with_contacts, before, first, end, rest);
  const bool by_threads = step_.mover() == LaunchedStep::Mover::Thread ||
                          (rest != nullptr && rest->multipliers != nullptr);
  if (by_threads) {
    kernels().adjoint_solve.launch(device, (end - first) * kVbdLanes, a);
  } else {
    kernels().adjoint_solve_team.launch(device, step_.team_rows(end - first), a);
  }
  const DeviceKernel& slots =
      rest != nullptr ? (weights ? kernels().adjoint_rest_weights : kernels().adjoint_rest)
                      : (weights ? kernels().adjoint_weights : kernels().adjoint_slots);
  slots.launch(device, static_cast<int64_t>(a.back().word), a);
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
void LaunchedReverse::end(bool with_contacts, bool weights, const Array* guess,
                          const Array& qd_bar) const {
  const Device device = step_.model_.device();
  const auto particles = static_cast<int64_t>(step_.model_.particle_count());
  kernels().adjoint_end.launch(
      device, particles,
      {reads_row("is_held", step_.is_held_), reads_row("x_bar", x_bar_),
       guess != nullptr ? updates_row("guess", *guess) : number(kNone), read_if("qd_bar", qd_bar),
       number(1.0f / step_.tables_->dt), updates_row("start_bar", start_bar_)});
  const std::vector<int64_t>& colors = step_.tables_->colors;
  const std::vector<LaunchArgument> a =
      arguments(with_contacts, nullptr, 0, colors.back(), nullptr);
  (weights ? kernels().adjoint_start_weights : kernels().adjoint_start)
      .launch(device, static_cast<int64_t>(a.back().word), a);
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
  kernels().adjoint_begin.launch(step_.model_.device(), step_.model_.particle_count(),
                                 {read_if("q_bar", q_bar), read_if("qd_bar", qd_bar),
                                  number(1.0f / step_.tables_->dt), writes_row("x_bar", x_bar_)});
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
  const Array* const guess = from_start ? &start_bar_ : &target_bar_;
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
  const float h = step_.tables_->dt;
  const bool guessed = !at_solution && in.last_velocity.rows() != 0;
  if (any({&g.particle_q, &g.particle_qd, &g.particle_f, &g.particle_mass, &g.gravity,
           &g.last_velocity}))
    kernels().particle_gradient.launch(
        m.device(), m.particle_count(),
        {reads_row("is_held", step_.is_held_),
         reads_row("inv_mass", m.particle_inv_mass),
         reads_row("f", in.f),
         reads_row("x_bar", x_bar_),
         reads_row("start_bar", start_bar_),
         reads_row("target_bar", target_bar_),
         reads_row("mass_bar", mass_bar_),
         number(h),
         number(int64_t{in.targets.rows() != 0}),
         write_if("particle_q", g.particle_q),
         write_if("particle_qd", g.particle_qd),
         write_if("particle_f", g.particle_f),
         write_if("particle_mass", g.particle_mass),
         any({&g.gravity}) ? writes_row("gravity_bar", gravity_bar_) : number(kNone),
         write_if("last_velocity", g.last_velocity),
         guessed ? reads_row("last_velocity", in.last_velocity) : number(kNone),
         reads_row("qd", in.qd),
         reads_row("world", m.particle_world),
         reads("gravity", m.gravity),
         number(int64_t{m.world_count()} - 1)});
  if (any({&g.targets}))
    kernels().target_gradient.launch(
        m.device(), step_.held_count(),
        {reads_row("held", step_.held_), reads("x_bar", x_bar_), writes("targets", g.targets)});
  if (any({&g.gravity}))
    kernels().gravity_gradient.launch(
        m.device(), m.world_count(),
        {reads("begin", tables_.world_begin), reads("particles", tables_.of_worlds),
         reads("gravity_bar", gravity_bar_), writes("gravity", g.gravity)});
}

std::vector<LaunchArgument> LaunchedReverse::law_bars(Role role) const {
  LaunchArgument numbers = reads("numbers", numbers_);
  numbers.word += static_cast<uint64_t>(tables_.numbers_begin[role]) * sizeof(float);
  return {reads("places", tables_.places[role]), std::move(numbers), number(int64_t{kVbdLanes})};
}

void LaunchedReverse::put_elements(const VbdStepArrays& g) const {
  const Model& m = step_.model_;
  const auto put = [&](const DeviceKernel& kernel, const Array& elements,
                       std::vector<LaunchArgument> arguments,
                       std::initializer_list<LaunchArgument> more) {
    arguments.insert(arguments.end(), more.begin(), more.end());
    kernel.launch(m.device(), static_cast<int64_t>(elements.rows()), arguments);
  };
  const LaunchArgument h = number(step_.tables_->dt);
  if (any({&g.particle_spring_stiffness, &g.particle_spring_damping,
           &g.particle_spring_rest_length}))
    put(kernels().spring_gradient, m.particle_spring_indices, law_bars(kSpring),
        {h, write_if("stiffness", g.particle_spring_stiffness),
         write_if("damping", g.particle_spring_damping),
         write_if("rest_length", g.particle_spring_rest_length)});
  if (any({&g.particle_tri_material, &g.particle_tri_activation, &g.particle_tri_area,
           &g.particle_tri_pose}))
    put(kernels().triangle_gradient, m.particle_tri_indices, law_bars(kTriangle),
        {reads("area", m.particle_tri_area), reads("material", m.particle_tri_material), h,
         write_if("material", g.particle_tri_material),
         write_if("activation", g.particle_tri_activation), write_if("area", g.particle_tri_area),
         write_if("pose", g.particle_tri_pose)});
  if (any({&g.particle_edge_material, &g.particle_edge_rest_angle, &g.particle_edge_rest_length})) {
    std::vector<LaunchArgument> bars = law_bars(kHingeOpposite), ends = law_bars(kHingeEnd);
    bars.insert(bars.end(), ends.begin(), ends.end());
    put(kernels().edge_gradient, m.particle_edge_indices, std::move(bars),
        {reads("material", m.particle_edge_material),
         reads("rest_length", m.particle_edge_rest_length), h,
         write_if("material", g.particle_edge_material),
         write_if("rest_angle", g.particle_edge_rest_angle),
         write_if("rest_length", g.particle_edge_rest_length)});
  }
  if (any({&g.particle_tet_material, &g.particle_tet_activation, &g.particle_tet_pose}))
    put(kernels().tetrahedron_gradient, m.particle_tet_indices, law_bars(kTetrahedron),
        {reads("pose", m.particle_tet_pose), reads("material", m.particle_tet_material), h,
         write_if("material", g.particle_tet_material),
         write_if("activation", g.particle_tet_activation), write_if("pose", g.particle_tet_pose)});
}

void LaunchedReverse::put_contacts(const VbdLaunchInputs& in, const VbdStepArrays& g) {
  const Model& m = step_.model_;
  const Device device = m.device();
  const bool with_contacts = in.have_contacts();
  if (any({&g.particle_radius}))
    kernels().radius_gradient.launch(
        device, m.particle_count(),
        {with_contacts ? reads("contact_begin", step_.contact_begin_) : number(kNone),
         with_contacts ? reads("contact_bars", contact_bars_) : number(kNone),
         writes_row("radius", g.particle_radius)});
  if (!any({&g.shape_margin, &g.shape_material_ke, &g.shape_material_kd, &g.shape_material_mu}))
    return;
  if (with_contacts) {
    const auto contacts = static_cast<int64_t>(in.contacts->soft_contact_max());
    kernels().contact_shape.launch(
        device, contacts,
        {reads("begin", step_.contact_begin_), reads("items", step_.contact_items_),
         number(int64_t{m.particle_count()}),
         reads("soft_contact_shape", in.contacts->soft_contact_shape),
         writes_row("shape_of_contact", shape_of_contact_)});
    kernels().incidence.launch(device, m.shape_count(),
                               {reads("shape_of_contact", shape_of_contact_), number(contacts),
                                writes("begin", shape_begin_), writes("items", of_shapes_)});
  }
  kernels().shape_gradient.launch(
      device, m.shape_count(),
      {with_contacts ? reads("begin", shape_begin_) : number(kNone),
       with_contacts ? reads("contacts", of_shapes_) : number(kNone),
       with_contacts ? reads("contact_bars", contact_bars_) : number(kNone),
       reads_row("shape_material_mu", m.shape_material_mu), number(m.soft_contact_mu),
       number(step_.tables_->dt), write_if("shape_margin", g.shape_margin),
       write_if("shape_material_ke", g.shape_material_ke),
       write_if("shape_material_kd", g.shape_material_kd),
       write_if("shape_material_mu", g.shape_material_mu)});
}

}  // namespace novaphy::vbd
