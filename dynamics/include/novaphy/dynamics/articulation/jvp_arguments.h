// What the tangent of a step of articulations reads and writes: the arguments of kernels, over
// arguments.h.
#pragma once

#include "novaphy/dynamics/articulation/arguments.h"
#include "novaphy/dynamics/articulation/dual.h"

namespace novaphy {

using articulation::DualFloat;

struct ArticulationJvpArguments {
  ArticulationArgumentsOf<DualFloat> in;
  DualFloat *q_next, *qd_next;  // what they were stays where a step fails
  Transform<DualFloat>* body_q;
  SpatialVector<DualFloat>* body_qd;
  const float* branch;  // of the step; a row per dof
  float* workspace;
  int64_t stride;  // numbers of it for an articulation
};

}  // namespace novaphy
