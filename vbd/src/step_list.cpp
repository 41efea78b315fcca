#include "step_list.h"

namespace novaphy::vbd {
namespace {

// Rows that a thread of the CPU takes at a time.
constexpr int64_t kParticleRows = 512, kLaneRows = 64;
constexpr int64_t kTeamThreads = 128;

VbdSweepArguments of_groups(VbdSweepArguments sweep, int64_t first, int64_t end) {
  sweep.first_group = first;
  sweep.end_group = end;
  return sweep;
}

}  // namespace

int64_t team_threads(int64_t groups, int64_t team) {
  return (groups + team - 1) / team * kTeamThreads;
}

// The particles of a colour move, one colour after the other.
void StepList::add_moves(const StepPlan& plan, const VbdSweepArguments& all) {
  const Kernel<VbdSweepArguments>& move = plan.team != 0   ? kernels().move_team
                                          : plan.safeguard ? kernels().move_guarded
                                                           : kernels().move;
  for (size_t c = 0; c + 1 < plan.colors.size(); ++c) {
    const int64_t first = plan.colors[c], end = plan.colors[c + 1], groups = end - first;
    const int64_t lanes = groups * plan.lanes;
    list_.add(move, plan.team != 0 ? team_threads(groups, plan.team) : lanes,
              of_groups(all, first, end), kLaneRows);
    if (plan.has_conflicts)
      list_.add(
          kernels().commit, lanes,
          {.particle = all.particle, .first_lane = first * plan.lanes, .from = all.to, .x = all.x},
          kLaneRows);
  }
}

StepList::StepList(const StepPlan& plan, const StepArguments& a,
                   std::span<const WritesRow<VbdRow>> iterates)
    : list_(plan.device) {
  const int64_t n = plan.particles, groups = plan.colors.back();
  const auto keep = [&](size_t iteration) {
    if (iteration < iterates.size())
      list_.add(kernels().keep, n, {.x = a.sweep.x, .iterate = iterates[iteration]}, kParticleRows);
  };
  predict_ = list_.add(kernels().predict, n, a.predict, kParticleRows);
  prepare_ =
      list_.add(kernels().prepare, groups * plan.lanes, of_groups(a.sweep, 0, groups), kLaneRows);
  iterations_.push_back(list_.size());
  for (int32_t k = 1; k <= plan.iterations; ++k) {
    keep(static_cast<size_t>(k - 1));
    add_moves(plan, a.sweep);
    if (!plan.chebyshev.empty())
      list_.add(kernels().accelerate, n,
                {.is_held = a.predict.is_held,
                 .contact_begin = a.sweep.contact_begin,
                 .omega = plan.chebyshev[static_cast<size_t>(k)],
                 .iteration = k,
                 .start = a.sweep.start,
                 .moved = a.sweep.moved,
                 .x = a.sweep.x,
                 .newer = a.newer,
                 .older = a.older},
                kParticleRows);
    iterations_.push_back(list_.size());
  }
  keep(static_cast<size_t>(plan.iterations));
  finish_ = list_.add(kernels().finish, n, a.finish, kParticleRows);
  again_ = list_.size();
  add_moves(plan, a.sweep);
}

}  // namespace novaphy::vbd
