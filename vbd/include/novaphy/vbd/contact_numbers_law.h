// The numbers of a contact in a step (slot_layout_law.h), from its record and the materials.
//
// Freestanding: device code reads it too.
#pragma once

#include "novaphy/math/types.h"
#include "novaphy/vbd/slot_layout_law.h"

namespace novaphy::vbd {

struct ContactMaterial {
  float ke, kd, mu;  // N/m, N*s/m, 1
};

// Means of the coefficients of the model and the shape, of mu the geometric one.
inline void put_contact_numbers(float* to, const Vec3f& point, const Vec3f& normal,
                                const Vec3f& velocity, float radius, const ContactMaterial& model,
                                const ContactMaterial& shape, float h) {
  const Vec3f travel = velocity * h;
  const Vec3f vectors[3] = {point, normal, travel};
  for (int k = 0; k < 3; ++k) {
    to[3 * k] = vectors[k].x;
    to[3 * k + 1] = vectors[k].y;
    to[3 * k + 2] = vectors[k].z;
  }
  to[9] = radius;
  to[10] = 0.5f * (model.ke + shape.ke);
  to[11] = (0.5f * (model.kd + shape.kd)) / h;
  to[12] = math::sqrt(model.mu * shape.mu);
}

}  // namespace novaphy::vbd
