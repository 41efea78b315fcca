// A step of several identical trees at once, one tree per SIMD lane. The algorithms are
// articulation/step.h and tree_contacts.h with lanes as the scalar type (lanes.h), compiled for one
// instruction set.
#pragma once

#include <cstdint>

#include "novaphy/dynamics/articulation/step_places.h"

namespace novaphy::articulation {

struct TreeShape {
  int32_t links = 0, dofs = 0, coords = 0, bodies = 0, joints = 0, joints_in_a_row = 0;
  const Link* link_rows = nullptr;  // row indices are relative to the tree's first row
  const int32_t* dof_parent = nullptr;
  const int32_t* target_mode = nullptr;
  // Constant arrays of the model are stored one after the other. `constant` has the offset of each
  // array, and `constants` the total size. `changing` lists the indices of the other arrays.
  int32_t constant[kStepArrays] = {};
  int32_t constants = 0;
  int32_t changing[kStepArrays] = {}, changing_count = 0;

  [[gnu::always_inline]] int32_t count(RowOf what) const {
    switch (what) {
      case RowOf::Coord:
        return coords;
      case RowOf::Dof:
        return dofs;
      case RowOf::Body:
        return bodies;
      case RowOf::Joint:
        return joints;
      default:
        return 1;
    }
  }
};

// Arguments of a step. Rows are those of the arrays of the model and the states.
struct LaneStepArguments {
  TreeShape shape = {};
  const float* constants = nullptr;  // {numbers, lanes}
  int32_t used = 0;                  // lanes in use; other lanes repeat one of these
  const int32_t *coord = nullptr, *dof = nullptr, *body = nullptr;  // {lanes}: first rows
  // Only the arrays in `changing` are read.
  const float* in[kStepArrays] = {};
  float *q_next = nullptr, *qd_next = nullptr, *body_q = nullptr, *body_qd = nullptr;
  float *qdd = nullptr, *branch = nullptr;  // null: not requested
  StepOptions<float> options = {};
  // Contacts. contact_count: the largest number of contacts of a lane. contacts: a TreeContact of
  // lanes per contact. contact_links {contacts, lanes}: link indices.
  int32_t contact_count = 0;
  const void* contacts = nullptr;
  const int32_t* contact_links = nullptr;
  float erp = 0.0f, slop = 0.0f, cfm = 0.0f, max_depenetration = 0.0f, restitution_threshold = 0.0f,
        tolerance = 0.0f;
  bool compliant = false, cone = true;
  int32_t most_sweeps = 1;
  float* impulses = nullptr;  // {contacts, 3, lanes}, along n, t1, t2
  float *sweeps = nullptr, *residual = nullptr, *largest = nullptr;  // {lanes}
  void* memory = nullptr;                                            // aligned to 64 bytes
};

// The adjoint of a step without contacts (articulation/step_vjp.h).
struct LaneVjpArguments {
  LaneStepArguments step = {};  // the inputs of the step, and the memory
  const float *qdd = nullptr, *branch = nullptr, *q_next = nullptr, *qd_next = nullptr;
  // Gradients by the outputs. Null: zero.
  const float *out_q = nullptr, *out_qd = nullptr, *out_body_q = nullptr, *out_body_qd = nullptr;
  float* gradient[kGradientArrays] = {};  // null: not requested
  int32_t add = 0;                        // flags of StepGradient
};

struct LaneIslands;  // lane_islands.h

struct LaneLevel {
  const char* name;
  int32_t lanes;
  int64_t (*memory)(const TreeShape&, int32_t contacts);  // returns bytes
  // Returns false, and writes nothing, if the matrix of a lane is not positive definite or a number
  // is not finite.
  bool (*step)(const LaneStepArguments&);
  int64_t (*vjp_memory)(const TreeShape&);
  void (*vjp)(const LaneVjpArguments&);
  int64_t (*islands_memory)(const LaneIslands&);
  void (*sweep_islands)(const LaneIslands&);
};
// Returns the best instruction set level for this processor, or the level that NOVAPHY_CPU_ISA
// names.
const LaneLevel& lane_level();

}  // namespace novaphy::articulation
