// The traced kernels of rigid contacts (diff_body_contacts.h): the wrenches {rows, 12} of both
// sides.
#pragma once

#include "novaphy/dynamics/semi_implicit/rigid_contact_trace.h"
#include "novaphy/nova/kernel.h"

namespace novaphy::diff::detail {

// `follow`: points and normals follow the bodies, whose shapes are then read too.
const nova::Kernel& rigid_kernel(bool follow);
// Of rows with materials of their own.
const nova::Kernel& own_rigid_kernel(bool follow);
// Of PenaltyLaw::Mean; a second parameter is half of the step.
const nova::Kernel& mean_kernel(bool follow, bool of_rows);
// Of a law of Newton.
const nova::Kernel& newton_kernel(FrictionLaw law, bool of_rows);

}  // namespace novaphy::diff::detail
