#include "step_list.h"

#include "step.h"

namespace novaphy::vbd {
namespace {

// Rows that a CPU thread takes at a time.
constexpr int64_t kParticleRows = 512, kLaneRows = 64, kMatrixRows = 4096;

}  // namespace

int64_t block_threads(int64_t groups, int64_t block_groups) {
  return (groups + block_groups - 1) / block_groups * kBlockRows;
}

// Adds the launches that move all colors, one color after the other.
void StepList::add_moves(const Step& step) {
  const int64_t block_groups = step.block_groups();
  const Kernel<VbdSweepArguments>& move = block_groups != 0          ? kernels().move_by_blocks
                                          : step.options().safeguard ? kernels().move_guarded
                                                                     : kernels().move;
  for (size_t c = 0; c + 1 < step.colors().size(); ++c) {
    const int64_t first = step.colors()[c], end = step.colors()[c + 1], groups = end - first;
    const int64_t lanes = groups * step.slots().lanes();
    const VbdSweepArguments sweep = step.sweep(first, end);
    list_.add(move, block_groups != 0 ? block_threads(groups, block_groups) : lanes, sweep,
              kLaneRows);
    if (step.slots().has_conflicts())
      list_.add(kernels().commit, lanes,
                {.particle = sweep.particle,
                 .first_lane = first * step.slots().lanes(),
                 .from = sweep.to,
                 .x = sweep.x},
                kLaneRows);
  }
}

void StepList::add_coarse_matrices(const Step& step) {
  const Coarse& coarse = *step.coarse();
  const int64_t groups = step.colors().back();
  const VbdCoarseArguments a = coarse.arguments(step.sweep(0, groups), 0);
  list_.add(kernels().clear, static_cast<int64_t>(coarse.matrix().rows()),
            {.values = coarse.matrix()}, kMatrixRows);
  list_.add(kernels().coarse_rows, groups * step.slots().lanes(), a, kLaneRows);
  list_.add(kernels().coarse_matrix, coarse.pairs(), a, kLaneRows);
  list_.add(kernels().coarse_factor, coarse.threads(), a, kBlockRows);
}

// Adds the launches of the coarse step of each system, with its line search.
void StepList::add_coarse_step(const Step& step) {
  const Coarse& coarse = *step.coarse();
  const int64_t groups = step.colors().back(), n = step.model().particle_count();
  const VbdSweepArguments sweep = step.sweep(0, groups);
  const auto add_load = [&](int64_t tests) {
    const VbdCoarseArguments a = coarse.arguments(sweep, tests);
    list_.add(kernels().coarse_force, groups * step.slots().lanes(), a, kLaneRows);
    list_.add(kernels().coarse_load, coarse.functions(), a, kLaneRows);
    if (tests == 0) {
      list_.add(kernels().coarse_solve, coarse.threads(), a, kBlockRows);
    } else {
      list_.add(kernels().coarse_test, coarse.systems(), a, 1);
    }
  };
  add_load(0);
  for (int64_t tests = 1; tests <= kVbdCoarseTests; ++tests) {
    list_.add(kernels().coarse_try, n, coarse.arguments(sweep, tests), kParticleRows);
    add_load(tests);
  }
  list_.add(kernels().coarse_take, n, coarse.arguments(sweep, 0), kParticleRows);
}

void StepList::add_coarse_balance(const Step& step) {
  const Coarse& coarse = *step.coarse();
  const int64_t groups = step.colors().back();
  VbdSweepArguments sweep = step.sweep(0, groups);
  sweep.turns = 0;  // the stiffness of the forces alone, so that the sum becomes zero
  const VbdCoarseArguments a = coarse.arguments(sweep, 0);
  list_.add(kernels().coarse_outer, groups * step.slots().lanes(), a, kLaneRows);
  list_.add(kernels().coarse_balance, coarse.systems(), a, kLaneRows);
  list_.add(kernels().coarse_shift, step.model().particle_count(), a, kParticleRows);
}

StepList::StepList(const Step& step, const VbdPredictArguments& predict,
                   const VbdFinishArguments& finish, std::span<const DeviceArray<Vec4f>> iterates,
                   std::span<const DeviceArray<Vec4f>> searches)
    : list_(step.device()) {
  const int64_t n = step.model().particle_count(), groups = step.colors().back();
  size_t kept = 0;
  const auto keep = [&] {
    if (kept >= iterates.size()) return;
    list_.add(kernels().keep, n, {.x = step.x(), .iterate = iterates[kept++]}, kParticleRows);
  };
  predict_ = list_.add(kernels().predict, n, predict, kParticleRows);
  prepare_ =
      list_.add(kernels().prepare, groups * step.slots().lanes(), step.sweep(0, groups), kLaneRows);
  iterations_.push_back(list_.size());
  const bool corrects = step.coarse() != nullptr && step.options().iterations > 0;
  for (int32_t k = 1; k <= step.options().iterations; ++k) {
    keep();
    add_moves(step);
    if (step.options().acceleration)
      list_.add(kernels().accelerate, n, step.acceleration(k), kParticleRows);
    if (corrects) {
      keep();
      if (k == 1) add_coarse_matrices(step);
      add_coarse_step(step);
      if (!searches.empty())
        list_.add(kernels().keep, step.coarse()->systems(),
                  {.x = step.coarse()->search(), .iterate = searches[static_cast<size_t>(k - 1)]});
    }
    iterations_.push_back(list_.size());
  }
  keep();
  if (corrects) add_coarse_balance(step);
  keep();
  finish_ = list_.add(kernels().finish, n, finish, kParticleRows);
  again_ = list_.size();
  add_moves(step);
}

}  // namespace novaphy::vbd
