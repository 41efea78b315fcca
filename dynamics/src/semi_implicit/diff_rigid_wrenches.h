// The traced kernels of rigid contacts (diff_body_contacts.h). Each computes the wrenches {rows,
// 12} on both sides of a contact.
#pragma once

#include "novaphy/dynamics/semi_implicit/rigid_contact_trace.h"
#include "novaphy/nova/kernel.h"

namespace novaphy::diff::detail {

// `follow`: points and normals follow the bodies, so the kernel also reads their shapes.
const nova::Kernel& rigid_kernel(bool follow);
// The kernel for contact rows with their own materials.
const nova::Kernel& own_rigid_kernel(bool follow);
// The kernel of PenaltyLaw::Mean. Its second parameter is half of the time step.
const nova::Kernel& mean_kernel(bool follow, bool of_rows);
// The kernel of a friction law of Newton.
const nova::Kernel& newton_kernel(FrictionLaw law, bool of_rows);

}  // namespace novaphy::diff::detail
