// The coefficients of a particle's contact for a step (elements/list.h), computed from a contact in
// Contacts and from the materials.
//
// Freestanding (no standard headers), because device code includes this header.
#pragma once

#include "novaphy/math/types.h"
#include "novaphy/vbd/elements/list.h"

namespace novaphy::vbd {

template <class T>
struct ContactMaterial {
  T ke, kd, mu;  // stiffness (N/m), damping (N*s/m), friction coefficient
};

// Combines the materials of the model and of the shape: the arithmetic means of ke and kd, and the
// geometric mean of mu. Calls put(k, value) for radius, ke, kd/h and mu (k = 0 to 3).
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
