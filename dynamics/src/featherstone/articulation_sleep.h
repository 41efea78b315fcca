// Internal: sleeping articulations in a step of SolverFeatherstone, on the CPU. Only a body on a
// FREE joint of its own can sleep.
#pragma once

#include <cstdint>
#include <vector>

#include "../sleep_step.h"
#include "contact_steps.h"
#include "novaphy/core/sim/control.h"
#include "novaphy/dynamics/featherstone/articulations.h"

namespace novaphy {

class ArticulationSleep {
 public:
  ArticulationSleep(const Model& model, const Articulations& articulations,
                    const SleepConfig& config);

  // Returns the articulations that sleep in a step from `in`; null: none. `step` has all wrenches.
  const SleepingTrees* begin(const Model& model, const SimState& in, const Contacts* contacts,
                             const Control* control, const ArticulationArguments& step, float dt);
  // Call after the step. Copies the rows of sleeping articulations from `in` to `out`, with status
  // 0.
  void keep(const Model& model, const SimState& in, SimState& out,
            const DeviceArray<int32_t>& status) const;
  // Call after a step that succeeded.
  void end(const Model& model, const SimState& in, SimState& out, float dt) {
    sleep_.end(model, in, out, dt);
  }

 private:
  struct Tree {
    int32_t body = -1, first_dof = 0;  // body -1: never sleeps
  };
  SleepStep sleep_;
  std::vector<Tree> all_;
  std::vector<int32_t> bound_;  // bodies that never sleep
  std::vector<int32_t> sides_, forced_, awake_;
  std::vector<uint8_t> asleep_;  // for each articulation
  SleepingTrees trees_;
  bool any_ = false;
};

}  // namespace novaphy
