#include "step_list.h"

#include "step.h"

namespace novaphy::vbd {
namespace {

// Rows that a thread of the CPU takes at a time.
constexpr int64_t kParticleRows = 512, kLaneRows = 64;
constexpr int64_t kBlockThreads = 128;

}  // namespace

int64_t block_threads(int64_t groups, int64_t block_groups) {
  return (groups + block_groups - 1) / block_groups * kBlockThreads;
}

// The particles of a color move, one color after the other.
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

StepList::StepList(const Step& step, const VbdPredictArguments& predict,
                   const VbdFinishArguments& finish, std::span<const DeviceArray<Vec4f>> iterates)
    : list_(step.device()) {
  const int64_t n = step.model().particle_count(), groups = step.colors().back();
  const auto keep = [&](size_t iteration) {
    if (iteration < iterates.size())
      list_.add(kernels().keep, n, {.x = step.x(), .iterate = iterates[iteration]}, kParticleRows);
  };
  predict_ = list_.add(kernels().predict, n, predict, kParticleRows);
  prepare_ =
      list_.add(kernels().prepare, groups * step.slots().lanes(), step.sweep(0, groups), kLaneRows);
  iterations_.push_back(list_.size());
  for (int32_t k = 1; k <= step.options().iterations; ++k) {
    keep(static_cast<size_t>(k - 1));
    add_moves(step);
    if (step.options().acceleration)
      list_.add(kernels().accelerate, n, step.acceleration(k), kParticleRows);
    iterations_.push_back(list_.size());
  }
  keep(static_cast<size_t>(step.options().iterations));
  finish_ = list_.add(kernels().finish, n, finish, kParticleRows);
  again_ = list_.size();
  add_moves(step);
}

}  // namespace novaphy::vbd
