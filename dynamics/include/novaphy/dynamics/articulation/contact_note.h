// ContactNote: what a record of an adjoint tells of a contact that pushes. Freestanding.
#pragma once

#include <cstdint>

#include "novaphy/math/types.h"

namespace novaphy::articulation {

// In the world. `impulse` (N s) acts on B. `adjoint`: the gradient by that impulse, with the shifts
// of the step held.
struct ContactNote {
  Vec3f point, normal, impulse, adjoint;
  int32_t held;  // 1: the derivative holds the point and the normal
};

}  // namespace novaphy::articulation
