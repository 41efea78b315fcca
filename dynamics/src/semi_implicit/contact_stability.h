// Up to which dt the springs and dampers of rigid contacts are stable.
//
// Law, for the rows that touch, n the normal and r the arm from the centre of mass of a body:
//   A = sum k J(n) J(n)^T  for ke and kd,  sum k (sum_u J(u) J(u)^T - J(n) J(n)^T)  for kf and
//   stick_ke, u the three axes,  J(u) = (u, r x u)
//   w = the largest eigenvalue of M^-1 A of a body, M its mass and inertia
//   springs (ke, stick_ke): dt < 2/sqrt(w),  dampers (kd, kf): dt < 2/w
// With the other bodies held that is necessary; with twice the k of rows of two bodies that move,
// which allows for neighbours in antiphase, it is enough.
#pragma once

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"

namespace novaphy {

struct ContactStability {
  struct Limit {
    float dt;           // s; infinite: none
    int32_t body = -1;  // that has it
  };
  Limit ke, kd, kf, stick_ke;
};

enum class OtherBodies { Held, InAntiphase };

// Reads on the host. The rows must be of shapes and bodies that are there.
ContactStability contact_stability(const Model& model, const SimState& state,
                                   const Contacts& contacts, OtherBodies others, float stick_ke);

}  // namespace novaphy
