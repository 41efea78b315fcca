// Finds the rows of rigid contacts with an exact gradient by the poses of their bodies.
#pragma once

#include <vector>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/export.h"

namespace novaphy {

// Of each row of rigid_contact_*, in their order: true where a step of DiffSemiImplicitSolver from
// `state` follows its points and normal with both bodies (moving_contact_trace.h); false where
// they stay as they are, the points in the frames of their bodies and the normal in the world. So
// do all rows that were not found from `state` as it is now
// (Contacts::rigid_contacts_found_from); a rollout that is given contacts holds all of them.
// Waits for a device. ErrorKind::Value: a state or contacts of another model.
NOVAPHY_DYNAMICS_API std::vector<bool> exact_contact_gradients(const Model& model,
                                                               const SimState& state,
                                                               const Contacts& contacts);

// Returns the same of one row that was found from these poses {bodies}, on the host.
bool has_exact_gradient(const Model& model, const DeviceArray<Transformf>& body_q,
                        const ContactFields& contacts, int32_t row);

}  // namespace novaphy
