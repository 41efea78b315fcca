// Between the derivatives by what slots, contacts and targets hold (ReversePass, TangentPass) and
// those by the arrays of a model and of a state.
#pragma once

#include <vector>

#include "novaphy/core/sim/index_rows.h"
#include "novaphy/vbd/differentiable_vbd.h"
#include "reverse_pass.h"
#include "tangent_pass.h"

namespace novaphy::vbd {

// Whether a derivative by a rest shape is wanted.
bool wants_weights(const VbdStepGradients& gradients);
// Whether a derivative by a damping is wanted, for which its terms run although it is 0.
bool wants_damping(const VbdStepGradients& gradients);
bool wants_damping(const VbdStepTangents& direction);
bool wants_damping(const VbdStepArrays& gradients);
// What put_gradients keeps from one call to the next.
struct GradientMemory {
  Rows by_gravity, by_last;  // of particles
  IndexRows of_worlds;       // particles
  std::vector<int32_t> shape_of_contact;
  IndexRows of_shapes;  // contacts
};
// `at_solution`: those of the solution, which does not depend on the guess.
void put_gradients(const ReversePass& pass, const VbdStepInputs& inputs,
                   const VbdStepGradients& gradients, bool at_solution, GradientMemory& memory);
void set_direction(TangentPass& pass, const VbdStepInputs& inputs,
                   const VbdStepTangents& direction);

}  // namespace novaphy::vbd
