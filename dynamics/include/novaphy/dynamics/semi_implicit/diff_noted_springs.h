// Penalty contacts ("springs") in the steps of diff_gradient_notes.h: their stiffness, and their
// entries in an AdjointRecord. Runs on the host. Compiled into novaphy::dynamics if nova is built.
//
// The wrench of a body is the sum of all wrenches on it. The gradient w of the loss by that sum
// gives the adjoint of the force F of a contact, which acts on B at the arm r:
//   adjoint of F = (w_B.linear + w_B.angular x r_B) - (w_A.linear + w_A.angular x r_A)
// The adjoint of the impulse F dt is the adjoint of F divided by dt. A contact pushes over several
// steps, and the change of each push changes later pushes. The recorded change of F therefore
// excludes the effect of earlier changes of the same pair. The sum of adjoint . change over the
// steps of a pair is then the part of the derivative that goes through the pair, except for the
// changes of arms.
#pragma once

#include <functional>
#include <span>

#include "novaphy/dynamics/diff_adjoint_record.h"
#include "novaphy/dynamics/diff_gradient_notes.h"
#include "novaphy/dynamics/export.h"

namespace novaphy {

// Returns the number of steps of an undamped touch: pi / (dt w) of the stiffest contact that
// pushes, w^2 = stiffness * inverse mass. Infinite: no such contact, or states that are not kept on
// the CPU.
NOVAPHY_DYNAMICS_API float steps_per_contact(const Model& model, std::span<const NotedStep> steps);

// Sets the gradients that the tape keeps for these steps to zero.
NOVAPHY_DYNAMICS_API void clear_gradients(std::span<const NotedStep> steps);
// Adds these steps to a record after a backward pass, the last step first.
NOVAPHY_DYNAMICS_API void add_springs(const Model& model, std::span<const NotedStep> steps,
                                      AdjointRecord& record);
// Fills `changes` of the record's steps with penalty contacts. Returns whether a contact pushes.
// `run` runs the tangent of the tape and is called once for each pair of shapes of a world.
bool find_changes_of_springs(AdjointRecord& record, const std::function<void()>& run);

}  // namespace novaphy
