// ArticulationSleep: sleeping articulations in a step of SolverFeatherstone, on the CPU. Internal.
// Only a body that forms an articulation alone, on a FREE joint, can sleep.
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

  // Returns the articulations that sleep in a step from `in`. Null: none. `step` must have all
  // wrenches.
  const SleepingTrees* begin(const Model& model, const SimState& in, const Contacts* contacts,
                             const Control* control, const ArticulationArguments& step, float dt);
  // Copies the rows of sleeping articulations from `in` to `out`, and sets their status to 0. Call
  // this after the step.
  void keep(const Model& model, const SimState& in, SimState& out,
            const DeviceArray<int32_t>& status) const;
  // Counts rest times and puts islands to sleep. Call this after a step that succeeded.
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
  std::vector<uint8_t> asleep_;  // per articulation
  SleepingTrees trees_;
  bool any_ = false;
};

}  // namespace novaphy
