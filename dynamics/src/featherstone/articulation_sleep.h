// Internal: the sleep of articulations in a step of SolverFeatherstone, on the CPU. Only bodies on
// a FREE joint of their own sleep.
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

  // Who sleeps in a step from `in`, of which `step` has all wrenches; null: nobody.
  const SleepingTrees* begin(const Model& model, const SimState& in, const Contacts* contacts,
                             const Control* control, const ArticulationArguments& step, float dt);
  // Behind the step: what sleeps is in `out` as in `in`, with the status 0.
  void keep(const Model& model, const SimState& in, SimState& out,
            const DeviceArray<int32_t>& status) const;
  // Behind a step that did not fail.
  void end(const Model& model, const SimState& in, SimState& out, float dt) {
    sleep_.end(model, in, out, dt);
  }

 private:
  struct Tree {
    int32_t body = -1, first_dof = 0;  // body -1: it never sleeps
  };
  SleepStep sleep_;
  std::vector<Tree> all_;
  std::vector<int32_t> bound_;  // bodies that never sleep
  std::vector<int32_t> sides_, forced_, awake_;
  std::vector<uint8_t> asleep_;  // of each articulation
  SleepingTrees trees_;
  bool any_ = false;
};

}  // namespace novaphy
