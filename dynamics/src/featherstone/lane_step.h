// A step of several trees alike at once, a lane each: articulation/step.h and tree_contacts.h with
// lanes as scalar (lanes.h), for one instruction set.
#pragma once

#include <cstdint>

#include "novaphy/dynamics/articulation/step_places.h"

namespace novaphy::articulation {

struct TreeShape {
  int32_t links = 0, dofs = 0, coords = 0, bodies = 0, joints = 0, joints_in_a_row = 0;
  const Link* link_rows = nullptr;  // all rows counted from the tree's first
  const int32_t* dof_parent = nullptr;
  const int32_t* target_mode = nullptr;
  // Arrays of the model stand one behind the other: where each begins, and the numbers of all. The
  // places of the others.
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

// Rows are those of the arrays.
struct LaneStepArguments {
  TreeShape shape = {};
  const float* constants = nullptr;  // {numbers, lanes}
  int32_t used = 0;                  // lanes that are written; the others repeat one of them
  const int32_t *coord = nullptr, *dof = nullptr, *body = nullptr;  // {lanes}: first rows
  const float* in[kStepArrays] = {};                                // those of `changing` are read
  float *q_next = nullptr, *qd_next = nullptr, *body_q = nullptr, *body_qd = nullptr;
  float *qdd = nullptr, *branch = nullptr;  // null: not asked for
  float dt = 0.0f, angular_damping = 0.0f;
  bool implicit_drives = true;
  // Contacts: the most of a lane; TreeContact of lanes, and the links {contacts, lanes}.
  int32_t contact_count = 0;
  const void* contacts = nullptr;
  const int32_t* contact_links = nullptr;
  float erp = 0.0f, slop = 0.0f, cfm = 0.0f, max_depenetration = 0.0f, restitution_threshold = 0.0f,
        tolerance = 0.0f;
  bool compliant = false, cone = true;
  int32_t most_sweeps = 1;
  float* impulses = nullptr;  // {contacts, 3, lanes}, along n, t1, t2
  float *sweeps = nullptr, *residual = nullptr, *largest = nullptr;  // {lanes}
  void* memory = nullptr;                                            // aligned to 64
};

// The adjoint of a step without contacts (articulation/step_vjp.h).
struct LaneVjpArguments {
  LaneStepArguments step = {};  // what it read; `memory`
  const float *qdd = nullptr, *branch = nullptr, *q_next = nullptr, *qd_next = nullptr;
  // Gradients of what it gave; null: zero.
  const float *out_q = nullptr, *out_qd = nullptr, *out_body_q = nullptr, *out_body_qd = nullptr;
  float* gradient[kGradientArrays] = {};  // null: not asked for
  int32_t add = 0;                        // of StepGradient
};

struct LaneLevel {
  const char* name;
  int32_t lanes;
  int64_t (*memory)(const TreeShape&, int32_t contacts);  // bytes
  // False: some lane's matrix is not positive definite or something is not finite; nothing is
  // written then.
  bool (*step)(const LaneStepArguments&);
  int64_t (*vjp_memory)(const TreeShape&);
  void (*vjp)(const LaneVjpArguments&);
};
// The best of this processor, or what NOVAPHY_CPU_ISA names.
const LaneLevel& lane_level();

}  // namespace novaphy::articulation
