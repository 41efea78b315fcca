// The force of a fluid on a body: the force on a box of uniform density that has the body's mass
// and principal inertia.
//
//   v, w     velocity of the center of mass relative to the fluid, angular velocity; box axes
//   b        side lengths of the box (m);  d = (bx + by + bz) / 3
//   force    -3 pi d viscosity v - density / 2 by bz |vx| vx, and likewise in y and z
//   moment   -pi d^3 viscosity w - density / 64 bx (by^4 + bz^4) |wx| wx, and likewise in y and z
// The force acts at the center of mass. The terms with the viscosity are those of a sphere of
// diameter d.
//
// Source: MuJoCo, "Computation", inertia-based model of fluid forces. Gradients: by pose, velocity,
// density, viscosity, wind and box. The rotation of the box in the body has no gradient.
#pragma once

#include "novaphy/dynamics/articulation/dual.h"
#include "novaphy/math/spatial.h"

namespace novaphy::articulation {

// The arrays of a fluid: density, viscosity and wind of worlds, and the boxes of bodies. A body
// reads eight numbers: density, viscosity, three of the wind, three of its box.
inline constexpr int32_t kFluidInputs = 4, kFluidNumbers = 8;
struct FluidPlace {
  int32_t input, at;  // the array, and the float in that array
};
inline FluidPlace fluid_place(int32_t number, int32_t world, int32_t body) {
  if (number < 2) return {number, world};
  if (number < 5) return {2, 3 * world + number - 2};
  return {3, 3 * body + number - 5};
}

// Returns the force, and the moment about the center of mass, in world axes. q: rotation of the
// body. motion: velocity of the center of mass. numbers: the body's eight numbers. frame: rotation
// of the box in the body.
template <class T>
SpatialVector<T> fluid_wrench(const Quat<T>& q, const SpatialVector<T>& motion,
                              const T (&numbers)[kFluidNumbers], const Quatf& frame) {
  constexpr float kPi = 0x1.921fb6p+1f;
  const T &density = numbers[0], &viscosity = numbers[1];
  const Vec3<T> wind = {numbers[2], numbers[3], numbers[4]};
  const T *const b = numbers + 5, o = T(0.0f);
  const Quat<T> axes = math::multiply(q, Quat<T>{T(frame.x), T(frame.y), T(frame.z), T(frame.w)});
  const Vec3<T> v = math::rotate_inverse(axes, motion.linear - wind),
                w = math::rotate_inverse(axes, motion.angular);
  const T d = (b[0] + b[1] + b[2]) * T(1.0f / 3.0f), slow = T(kPi) * viscosity * d,
          turning = slow * d * d;
  const auto drag = [&](const T& x, const T& by_rate, const T& by_square) {
    return -(x * (by_rate + by_square * select(x < o, -x, x)));
  };
  const auto area = [&](const T& y, const T& z) { return T(0.5f) * density * y * z; };
  const auto moment = [&](const T& x, const T& y, const T& z) {
    const T yy = y * y, zz = z * z;
    return T(1.0f / 64.0f) * density * x * (yy * yy + zz * zz);
  };
  const T pushing = T(3.0f) * slow;
  const Vec3<T> force = {drag(v.x, pushing, area(b[1], b[2])), drag(v.y, pushing, area(b[2], b[0])),
                         drag(v.z, pushing, area(b[0], b[1]))};
  const Vec3<T> torque = {drag(w.x, turning, moment(b[0], b[1], b[2])),
                          drag(w.y, turning, moment(b[1], b[2], b[0])),
                          drag(w.z, turning, moment(b[2], b[0], b[1]))};
  return {math::rotate(axes, force), math::rotate(axes, torque)};
}

}  // namespace novaphy::articulation
