// Finds which rigid contacts have an exact gradient by the poses of their bodies.
#pragma once

#include <vector>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/export.h"

namespace novaphy {

// Returns for each row of rigid_contact_* whether its gradient is exact in a step of
// DiffSemiImplicitSolver from `state`. true: points and normal move with both bodies
// (moving_contact_trace.h). false ("frozen"): the points are constant in the frames of their
// bodies, and the normal in the world. Rows that were not found from the present `state` are frozen
// (Contacts::rigid_contacts_found_from). A rollout with given contacts freezes all rows. Waits for
// a device. ErrorKind::Value: a state or contacts of another model.
NOVAPHY_DYNAMICS_API std::vector<bool> exact_contact_gradients(const Model& model,
                                                               const SimState& state,
                                                               const Contacts& contacts);

// Returns whether a contact of a particle with a shape of the world has an exact gradient while its
// point and normal are frozen: the shape is an endless plane.
NOVAPHY_DYNAMICS_API bool is_exact_while_frozen(const Model& model, int32_t shape);

// Returns whether the gradient of one row is exact. The row must have been found from the poses
// body_q {bodies}, and all arrays must be on the host.
bool has_exact_gradient(const Model& model, const DeviceArray<Transformf>& body_q,
                        const ContactFields& contacts, int32_t row);

}  // namespace novaphy
