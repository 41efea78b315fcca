// The traced kernels of rigid contacts (diff_body_contacts.h). Each kernel computes the wrenches
// {rows, 12} on both sides of a contact.
#pragma once

#include "novaphy/dynamics/semi_implicit/rigid_contact_trace.h"
#include "novaphy/nova/kernel.h"

namespace novaphy::diff::detail {

// Returns the kernel. `follow`: points and normals move with the bodies, so the kernel also reads
// the bodies' shapes.
const nova::Kernel& rigid_kernel(bool follow);
// Returns the kernel for contact rows with their own materials.
const nova::Kernel& own_rigid_kernel(bool follow);
// Returns the kernel of PenaltyLaw::Mean. Its second parameter is half of the time step.
const nova::Kernel& mean_kernel(bool follow, bool of_rows);
// Returns the kernel of a friction law of Newton.
const nova::Kernel& newton_kernel(FrictionLaw law, bool of_rows);

}  // namespace novaphy::diff::detail
