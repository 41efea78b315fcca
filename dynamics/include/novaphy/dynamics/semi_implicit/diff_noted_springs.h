// The stiffness of penalty contacts in noted steps (diff_gradient_notes.h), and their entries in an
// AdjointRecord. On the host. Compiled into novaphy::dynamics where nova is built.
//
// The wrench of a body is the sum of all wrenches on it. The gradient w of the loss by that sum
// gives the adjoint of the force F of a contact, which acts on B at the arm r:
//   adjoint of F = (w_B.linear + w_B.angular x r_B) - (w_A.linear + w_A.angular x r_A)
// and the adjoint of the impulse F dt is that of F over dt.
// A contact pushes over several steps, and each push changes the later ones. The change of F is
// therefore that of a motion to which earlier changes of the same pair were not handed on. The sum
// of adjoint . change over the steps of a pair is then the part of the derivative that goes through
// the pair, but for the changes of arms.
#pragma once

#include <functional>
#include <span>

#include "novaphy/dynamics/diff_adjoint_record.h"
#include "novaphy/dynamics/diff_gradient_notes.h"
#include "novaphy/dynamics/export.h"

namespace novaphy {

// Returns pi / (dt w) of the stiffest contact that pushes, w^2 = stiffness * inverse mass: the
// steps of a touch without damping. Infinite: no such contact, or states that are not kept on the
// CPU.
NOVAPHY_DYNAMICS_API float steps_per_contact(const Model& model, std::span<const NotedStep> steps);

// Sets the gradients that the tape keeps for these steps to zero.
NOVAPHY_DYNAMICS_API void clear_gradients(std::span<const NotedStep> steps);
// Adds these steps to a record, the last one first, after an adjoint.
NOVAPHY_DYNAMICS_API void add_springs(const Model& model, std::span<const NotedStep> steps,
                                      AdjointRecord& record);
// Fills `changes` of steps with springs. Returns whether a contact pushes. `run` runs the tangent
// of the tape, once for each pair of a world.
bool find_changes_of_springs(AdjointRecord& record, const std::function<void()>& run);

}  // namespace novaphy
