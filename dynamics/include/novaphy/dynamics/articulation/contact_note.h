// ContactNote: a contact that pushed in a step, with the adjoint of its impulse, as a backward pass
// records it. Freestanding.
#pragma once

#include <cstdint>

#include "novaphy/math/types.h"

namespace novaphy::articulation {

// All vectors are in the world. `impulse` (N s) acts on side B. `adjoint`: the gradient by that
// impulse, with the shifts of the step (pgs.h) constant.
struct ContactNote {
  Vec3f point, normal, impulse, adjoint;
  int32_t held;  // 1: point and normal are constant in the derivative
};

}  // namespace novaphy::articulation
