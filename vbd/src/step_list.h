// A step of VBD as a list of launches. The list has the order of the operations of a step, on the
// host and on devices.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "novaphy/core/launch_list.h"
#include "step_kernel_set.h"

namespace novaphy::vbd {

class Step;

class StepList {
 public:
  // `iterates`: where to store the positions before each iteration. With a coarse correction also
  // the positions after each sweep, then before and after the balance of free systems. `searches`:
  // where to store the line searches. Empty spans: nothing is stored.
  StepList(const Step& step, const VbdPredictArguments& predict, const VbdFinishArguments& finish,
           std::span<const DeviceArray<Vec4f>> iterates,
           std::span<const DeviceArray<Vec4f>> searches);

  void set(const VbdPredictArguments& arguments) { list_.set(predict_, arguments); }
  void set(const VbdFinishArguments& arguments) { list_.set(finish_, arguments); }

  // Run the parts of the list, in their order.
  void predict() const { list_.run(predict_.number, prepare_.number); }
  void prepare() const { list_.run(prepare_.number, iterations_.front()); }
  void iterate(size_t first, size_t last) const {
    list_.run(iterations_[first], iterations_[last]);
  }
  void balance() const { list_.run(iterations_.back(), finish_.number); }
  void finish() const { list_.run(finish_.number, again_); }
  // Runs one more iteration, without acceleration.
  void move_again() const { list_.run(again_, list_.size()); }

 private:
  void add_moves(const Step& step);
  // Add the launches of the coarse correction: its matrices, one correction, and the balance of
  // free systems.
  void add_coarse_matrices(const Step& step);
  void add_coarse_step(const Step& step);
  void add_coarse_balance(const Step& step);

  LaunchList list_;
  LaunchList::Place<VbdPredictArguments> predict_;
  LaunchList::Place<VbdSweepArguments> prepare_;
  LaunchList::Place<VbdFinishArguments> finish_;
  std::vector<size_t> iterations_;  // first launch of each iteration, then the end
  size_t again_ = 0;
};

// Returns the number of threads of a launch whose thread blocks have `block_groups` groups.
int64_t block_threads(int64_t groups, int64_t block_groups);

}  // namespace novaphy::vbd
