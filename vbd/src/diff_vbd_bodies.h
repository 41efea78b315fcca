// One step of bodies of DiffSolverVBD as a tape stores it.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/nova/tape.h"
#include "novaphy/vbd/differentiable_bodies.h"
#include "unsolved_steps.h"

namespace novaphy::diff {

struct RecordedBodies {
  std::shared_ptr<const Model> model;
  std::shared_ptr<DifferentiableBodies> steps;
  std::shared_ptr<const SimState> in;      // views of the state at the start and of the forces
  std::shared_ptr<const Control> control;  // views of the control; null: the model's
  float dt = 0.0f;
  int32_t of_rollout = -1;  // index of the step in a rollout; -1: not in a rollout
  std::shared_ptr<const VbdBodySolution> solution;
  StepReport report;

  // An input with a gradient, and the member of VbdBodyDerivatives that holds its derivative.
  struct Input {
    nova::Tensor tensor;
    Array VbdBodyDerivatives::*derivative;
  };
  std::vector<Input> differentiable() const;
  void backward(std::span<const nova::Tensor> outputs,
                std::span<const nova::InputGradient> to) const;
  void tangent(std::span<const nova::Tensor> tangents, std::span<const nova::Tensor> outputs) const;
};

}  // namespace novaphy::diff
