#include "step_kernel_set.h"

#include "sweep.h"

namespace novaphy::detail {
const char* vbd_kernels_text();
const char* vbd_adjoint_kernels_text();
const char* vbd_gradient_kernels_text();
const char* vbd_tangent_kernels_text();
}  // namespace novaphy::detail

namespace novaphy::vbd {
namespace {

float* floats(VbdRow* rows) { return rows == nullptr ? nullptr : &rows->x; }
const float* floats(const VbdRow* rows) { return rows == nullptr ? nullptr : &rows->x; }

// What the sweep of an instruction set reads, of the arguments of a launch.
Sweep sweep_of(const VbdSweepArguments& a, bool safeguard) {
  Sweep s;
  s.particle = a.particle;
  s.filled = a.filled;
  s.mass_by_h2 = a.mass_by_h2;
  for (int role = 0; role < kRoles; ++role)
    s.slots[role] = {a.begin[role], a.ints[role], a.floats[role], ((a.damped >> role) & 1) != 0};
  s.contact_begin = a.contact_begin;
  s.contacts = a.contacts;
  s.start = floats(a.start.rows());
  s.target = floats(a.target.rows());
  s.moved = floats(a.moved.rows());
  s.x = floats(a.x.rows());
  s.step = a.to.rows() != a.x.rows() ? floats(a.to.rows()) : nullptr;
  s.regularization = a.regularization;
  s.slip = a.slip;
  s.safeguard = safeguard;
  return s;
}

// On the CPU, the groups of a launch over their lanes run with all lanes of its instruction set.
template <class Body>
void for_groups(const VbdSweepArguments& a, int64_t begin, int64_t end, const Body& body) {
  const SweepLevel& level = sweep_level_of(a.lanes);
  const int64_t lanes = level.lanes, last = (end + lanes - 1) / lanes;
  for (int64_t group = (begin + lanes - 1) / lanes; group < last; ++group)
    body(level, a.first_group + group);
}
template <class A>
const A& arguments_of(const uint64_t* words) {
  return novaphy::detail::arguments_of<A>(words);
}

void prepare_lanes(const uint64_t* words, int64_t, int64_t begin, int64_t end) {
  const auto& a = arguments_of<VbdSweepArguments>(words);
  const Sweep sweep = sweep_of(a, false);
  for_groups(a, begin, end,
             [&](const SweepLevel& level, int64_t group) { level.prepare(sweep, group); });
}
template <bool safeguard>
void move_lanes(const uint64_t* words, int64_t, int64_t begin, int64_t end) {
  const auto& a = arguments_of<VbdSweepArguments>(words);
  const Sweep sweep = sweep_of(a, safeguard);
  for_groups(a, begin, end,
             [&](const SweepLevel& level, int64_t group) { level.move(sweep, group); });
}
void residual_lanes(const uint64_t* words, int64_t, int64_t begin, int64_t end) {
  const auto& a = arguments_of<VbdSweepArguments>(words);
  const Sweep sweep = sweep_of(a, false);
  auto* const of_particles = reinterpret_cast<ParticleResidual*>(a.residual.rows());
  for_groups(a, begin, end, [&](const SweepLevel& level, int64_t group) {
    level.residual(sweep, group, of_particles);
  });
}

Adjoint bars_of(const VbdAdjointArguments& a, bool at_rest, bool weights) {
  Adjoint bars;
  bars.x = floats(a.x_bar.rows());
  bars.multiplier = floats(a.multiplier.rows());
  bars.multiplier_sum = floats(a.multiplier_sum.rows());
  bars.start = floats(a.start_bar.rows());
  bars.target = floats(a.target_bar.rows());
  bars.mass_by_h2 = a.mass_bar;
  bars.contacts = a.contact_bars;
  for (int role = 0; role < kRoles; ++role) {
    bars.others[role] = a.terms + a.begins[kRoles + role];
    bars.numbers[role] = a.numbers + a.begins[2 * kRoles + role];
  }
  bars.weights = weights;
  bars.at_rest = at_rest;
  return bars;
}
template <bool at_rest, bool weights>
void adjoint_lanes(const uint64_t* words, int64_t, int64_t begin, int64_t end) {
  const auto& a = arguments_of<VbdAdjointArguments>(words);
  const Sweep sweep = sweep_of(a.sweep, false);
  const Adjoint bars = bars_of(a, at_rest, weights);
  for_groups(a.sweep, begin, end, [&](const SweepLevel& level, int64_t group) {
    for (int64_t k = group * level.lanes; a.before != nullptr && k < (group + 1) * level.lanes; ++k)
      a.sweep.x[sweep.particle[k]] = a.before[sweep.particle[k]];
    level.adjoint(sweep, bars, group);
  });
}
template <bool weights>
void adjoint_start_lanes(const uint64_t* words, int64_t, int64_t begin, int64_t end) {
  const auto& a = arguments_of<VbdAdjointArguments>(words);
  const Sweep sweep = sweep_of(a.sweep, false);
  const Adjoint bars = bars_of(a, false, weights);
  for_groups(a.sweep, begin, end, [&](const SweepLevel& level, int64_t group) {
    level.adjoint_start(sweep, bars, group);
  });
}

Tangents tangents_of(const VbdTangentArguments& a) {
  Tangents t;
  t.x = floats(a.x.rows());
  t.start = floats(a.start.rows());
  t.target = floats(a.target.rows());
  t.mass_by_h2 = a.mass;
  t.contacts = a.contacts;
  for (int role = 0; a.numbers != nullptr && role < kRoles; ++role)
    t.numbers[role] = a.numbers + a.begins[role];
  t.load = floats(a.load.rows());
  t.at_rest = a.at_rest != 0;
  t.keeps_loads = a.keeps_loads != 0;
  t.force = floats(a.force.rows());
  t.force_slope = floats(a.force_slope.rows());
  t.step_slope = floats(a.step_slope.rows());
  return t;
}
template <bool start>
void tangent_lanes(const uint64_t* words, int64_t, int64_t begin, int64_t end) {
  const auto& a = arguments_of<VbdTangentArguments>(words);
  const Sweep sweep = sweep_of(a.sweep, false);
  const Tangents t = tangents_of(a);
  for_groups(a.sweep, begin, end, [&](const SweepLevel& level, int64_t group) {
    (start ? level.tangent_start : level.tangent)(sweep, t, group);
  });
}

template <class A>
constexpr RowKernel<A> with_lanes(RowKernel<A> kernel, decltype(kernel.rows) rows) {
  kernel.rows = rows;
  return kernel;
}
// Kernels refer to them.
template <const auto& kernel, auto rows>
constexpr auto kLanes = with_lanes(kernel, rows);

}  // namespace

int lanes_on(Device device) { return device.is_cpu() ? sweep_level().lanes : kVbdLanes; }

const StepKernels& step_kernels() {
  const DeviceText text = detail::vbd_kernels_text,
                   gradient_text = detail::vbd_gradient_kernels_text;
  static const auto& all =
      *new StepKernels{.predict{vbd_predict, text},
                       .target{vbd_target, text},
                       .activation{vbd_activation, text},
                       .contact{vbd_contact, text},
                       .prepare{kLanes<vbd_prepare, prepare_lanes>, text},
                       .move{kLanes<vbd_move, move_lanes<false>>, text},
                       .move_guarded{kLanes<vbd_move_guarded, move_lanes<true>>, text},
                       .move_team{vbd_move_team, text},
                       .residual{kLanes<vbd_residual, residual_lanes>, text},
                       .commit{vbd_commit, text},
                       .accelerate{vbd_accelerate, text},
                       .keep{vbd_keep, gradient_text},
                       .finish{vbd_finish, text},
                       .clear{vbd_clear, gradient_text}};
  return all;
}

const AdjointKernels& adjoint_kernels() {
  const DeviceText text = detail::vbd_adjoint_kernels_text;
  static const auto& all = *new AdjointKernels{
      .solve{vbd_adjoint_solve, text},
      .solve_team{vbd_adjoint_solve_team, text},
      .slots{{{kLanes<vbd_adjoint_slots, adjoint_lanes<false, false>>, text},
              {kLanes<vbd_adjoint_weights, adjoint_lanes<false, true>>, text}},
             {{kLanes<vbd_adjoint_rest, adjoint_lanes<true, false>>, text},
              {kLanes<vbd_adjoint_rest_weights, adjoint_lanes<true, true>>, text}}},
      .start{{kLanes<vbd_adjoint_start, adjoint_start_lanes<false>>, text},
             {kLanes<vbd_adjoint_start_weights, adjoint_start_lanes<true>>, text}}};
  return all;
}

const TangentKernels& tangent_kernels() {
  const DeviceText text = detail::vbd_tangent_kernels_text;
  static const auto& all =
      *new TangentKernels{.tangent{kLanes<vbd_tangent, tangent_lanes<false>>, text},
                          .start{kLanes<vbd_tangent_start, tangent_lanes<true>>, text},
                          .move{vbd_tangent_move, text}};
  return all;
}

}  // namespace novaphy::vbd
