// What the adjoint of a step of articulations reads and writes: the arguments of kernels, over
// arguments.h.
#pragma once

#include "novaphy/dynamics/articulation/arguments.h"
#include "novaphy/dynamics/articulation/step_vjp.h"

namespace novaphy {

struct ArticulationStepVjpArguments {
  ArticulationArguments in;
  const float* qdd;
  const float* branch;
  const float *q_next, *qd_next;
  articulation::StepOutputGradient<float> out;
  articulation::StepGradient<float> gradient;  // ends with `add`, in a word of its own
  float* workspace;
  int64_t stride;
};

}  // namespace novaphy
