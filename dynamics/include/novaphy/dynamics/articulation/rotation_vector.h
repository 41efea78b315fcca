// The rotation vector of a unit quaternion, and its derivative.
#pragma once

#include "novaphy/dynamics/articulation/scalar.h"
#include "novaphy/math/types.h"

namespace novaphy::articulation {

// Power series are used if the squared sine of half the angle is below this value.
inline constexpr float kSmallSine2 = 0.01f;

// Returns the rotation vector phi of the unit quaternion r = exp(phi), at most half a turn long.
template <class T>
Vec3<T> rotation_vector(Quat<T> r) {
  const T one = T(1.0f);
  const T side = select(r.w < T(0.0f), -one, one);
  const Vec3<T> v = Vec3<T>{r.x, r.y, r.z} * side;
  const T square = (v.x * v.x + v.y * v.y) + v.z * v.z;
  const auto small = square < T(kSmallSine2);
  const T sine = square_root(select(small, one, square));
  // The angle divided by the sine s of its half: 2 asin(s) / s.
  const T series =
      T(2.0f) + square * (T(1.0f / 3.0f) + square * (T(3.0f / 20.0f) + square * T(5.0f / 56.0f)));
  const T exact = T(2.0f) * angle_of(sine, r.w * side) / sine;
  return v * select(small, series, exact);
}

// Converts a gradient h by phi to the gradient by a small rotation e, where r becomes exp(e) r
// (side 1) or r exp(e) (side -1):
//   h + side phi x h / 2 + c phi x (phi x h), c = (1 - (|phi| / 2) cot(|phi| / 2)) / |phi|^2
// Source: Sola, Deray and Atchuthan, A micro Lie theory (2018), equations 144 and 146.
template <class T>
Vec3<T> rotation_vector_vjp(const Vec3<T>& phi, const Vec3<T>& h, float side) {
  const T one = T(1.0f), square = T(0.25f) * ((phi.x * phi.x + phi.y * phi.y) + phi.z * phi.z);
  const auto small = square < T(kSmallSine2);
  const T half = square_root(select(small, one, square));
  const SinCos<T> of = sin_cos(half);
  const T series = T(1.0f / 12.0f) + square * (T(1.0f / 180.0f) + square * T(1.0f / 1890.0f));
  const T exact = (one - half * of.cos / of.sin) / (T(4.0f) * half * half);
  const Vec3<T> turned = math::cross(phi, h);
  return h + (turned * T(0.5f * side) + math::cross(phi, turned) * select(small, series, exact));
}

}  // namespace novaphy::articulation
