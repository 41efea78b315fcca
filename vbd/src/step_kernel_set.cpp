#include "step_kernel_set.h"

#include "sweep.h"

namespace novaphy::detail {
const char* vbd_kernels_text();
const char* vbd_gradient_kernels_text();
}  // namespace novaphy::detail

namespace novaphy::vbd {
namespace {

// What the sweep of an instruction set reads, of the arguments of a launch.
Sweep sweep_of(const VbdSweepArguments& a, bool safeguard) {
  const auto floats = [](auto* rows) { return rows == nullptr ? nullptr : &rows->x; };
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
template <bool safeguard, class Body>
void for_groups(const uint64_t* words, int64_t begin, int64_t end, const Body& body) {
  const auto& a = novaphy::detail::arguments_of<VbdSweepArguments>(words);
  const Sweep sweep = sweep_of(a, safeguard);
  const SweepLevel& level = sweep_level_of(a.lanes);
  const int64_t lanes = level.lanes, last = (end + lanes - 1) / lanes;
  for (int64_t group = (begin + lanes - 1) / lanes; group < last; ++group)
    body(level, sweep, a.first_group + group, a);
}
void prepare_lanes(const uint64_t* words, int64_t, int64_t begin, int64_t end) {
  for_groups<false>(words, begin, end,
                    [](const SweepLevel& level, const Sweep& sweep, int64_t group,
                       const VbdSweepArguments&) { level.prepare(sweep, group); });
}
template <bool safeguard>
void move_lanes(const uint64_t* words, int64_t, int64_t begin, int64_t end) {
  for_groups<safeguard>(words, begin, end,
                        [](const SweepLevel& level, const Sweep& sweep, int64_t group,
                           const VbdSweepArguments&) { level.move(sweep, group); });
}
void residual_lanes(const uint64_t* words, int64_t, int64_t begin, int64_t end) {
  for_groups<false>(
      words, begin, end,
      [](const SweepLevel& level, const Sweep& sweep, int64_t group, const VbdSweepArguments& a) {
        level.residual(sweep, group, reinterpret_cast<ParticleResidual*>(a.residual.rows()));
      });
}
using SweepKernel = RowKernel<VbdSweepArguments>;
constexpr SweepKernel with_lanes(SweepKernel kernel, decltype(kernel.rows) rows) {
  kernel.rows = rows;
  return kernel;
}
constexpr SweepKernel kPrepare = with_lanes(vbd_prepare, prepare_lanes),
                      kMove = with_lanes(vbd_move, move_lanes<false>),
                      kMoveGuarded = with_lanes(vbd_move_guarded, move_lanes<true>),
                      kResidual = with_lanes(vbd_residual, residual_lanes);

}  // namespace

const StepKernels& step_kernels() {
  const DeviceText text = detail::vbd_kernels_text,
                   gradient_text = detail::vbd_gradient_kernels_text;
  static const auto& all = *new StepKernels{.predict{vbd_predict, text},
                                            .prepare{kPrepare, text},
                                            .move{kMove, text},
                                            .move_guarded{kMoveGuarded, text},
                                            .move_team{vbd_move_team, text},
                                            .residual{kResidual, text},
                                            .commit{vbd_commit, text},
                                            .accelerate{vbd_accelerate, text},
                                            .keep{vbd_keep, gradient_text},
                                            .finish{vbd_finish, text},
                                            .clear{vbd_clear, gradient_text}};
  return all;
}

}  // namespace novaphy::vbd
