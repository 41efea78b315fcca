// The numbers of a contact in a step (elements/list.h), from the contact's record and the
// materials.
//
// Freestanding: device code reads it too.
#pragma once

#include "novaphy/math/types.h"
#include "novaphy/vbd/elements/list.h"

namespace novaphy::vbd {

template <class T>
struct ContactMaterial {
  T ke, kd, mu;  // N/m, N*s/m, 1
};

// Combines the materials of the model and the shape: arithmetic means of ke and kd, the geometric
// mean of mu. Calls put(k, value) for the k-th number of the law.
template <class T, class Put>
void put_contact_law(const T& radius, const ContactMaterial<T>& model,
                     const ContactMaterial<T>& shape, const T& h, const Put& put) {
  using math::sqrt;
  put(0, radius);
  put(1, T(0.5f) * (model.ke + shape.ke));
  put(2, (T(0.5f) * (model.kd + shape.kd)) / h);
  put(3, sqrt(model.mu * shape.mu));
}

inline void put_contact_numbers(float* to, const Vec3f& point, const Vec3f& normal,
                                const Vec3f& velocity, float radius,
                                const ContactMaterial<float>& model,
                                const ContactMaterial<float>& shape, float h) {
  const Vec3f travel = velocity * h;
  const Vec3f vectors[3] = {point, normal, travel};
  for (int k = 0; k < 3; ++k) {
    to[3 * k] = vectors[k].x;
    to[3 * k + 1] = vectors[k].y;
    to[3 * k + 2] = vectors[k].z;
  }
  put_contact_law(radius, model, shape, h, [to](int k, float value) { to[9 + k] = value; });
}

}  // namespace novaphy::vbd
