// The memory of a solver of bodies from step to step, as rows of four floats.
#pragma once

#include "novaphy/math/types.h"

namespace novaphy {

// The multipliers of a contact, found again by its shapes and its feature.
struct alignas(16) VbdContactMemory {
  int32_t shape[2] = {-1, -1};
  int32_t point = -1;
  float lam_n = 0.0f;
  Vec3f lam_t{};
  float is_used = 0.0f;  // 0: no contact
  Vec3f normal{};
  float unused = 0.0f;
};

// The multipliers of a joint in the axes of its parent, and the angle with all turns.
struct alignas(16) VbdJointMemory {
  Vec3f lam{};
  float coordinate = 0.0f;
  Vec3f lam_turn{};
  float is_used = 0.0f;  // 0: no step before
  float axis[4] = {};
};

}  // namespace novaphy
