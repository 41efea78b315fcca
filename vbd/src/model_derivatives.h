// Between the derivatives by what slots, contacts and targets hold (ReversePass, TangentPass) and
// those by the arrays of a model and of a state.
#pragma once

#include "novaphy/vbd/differentiable_vbd.h"
#include "reverse_pass.h"
#include "tangent_pass.h"

namespace novaphy::vbd {

// Whether a derivative by a rest shape is wanted.
bool wants_weights(const VbdStepGradients& gradients);
// `at_solution`: those of the solution, which does not depend on the guess.
void put_gradients(const ReversePass& pass, const VbdStepInputs& inputs,
                   const VbdStepGradients& gradients, bool at_solution);
void set_direction(TangentPass& pass, const VbdStepInputs& inputs,
                   const VbdStepTangents& direction);

}  // namespace novaphy::vbd
