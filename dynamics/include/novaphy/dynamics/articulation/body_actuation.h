// Actuators on bodies: each applies a wrench to a frame of one body, and the opposite wrench to a
// frame of a reference body.
//
//   F, M     force (1) and moment (m) per newton of actuator force, in world axes: rotated with the
//            actuator's frame or with the reference frame (ActuatorAxes)
//   l        length: 0, or F . (x - x_ref) + M . log(R_ref^T R) in the axes of the reference
//   v        rate: F . (x' - x_ref') + M . (w - w_ref) - w_common . ((x - x_ref) x F)
// x are the origins of the frames, w the angular velocities, and w_common belongs to the nearest
// common ancestor of both bodies. The actuator force f is that of an actuator with l and v
// (actuation.h).
//
// The body gets the force f F at x and the moment f M. The reference body gets the opposite at
// x_ref. The unbalanced moment f (x - x_ref) x F acts on the common ancestor, so that no joint
// above both bodies feels the pair. All forces are taken at the start of the step.
//
// Source: MuJoCo, "Computation", transmission of sites. Kink: log is not smooth at half a turn.
#pragma once

#include "novaphy/dynamics/articulation/actuation.h"
#include "novaphy/dynamics/articulation/kinematics.h"
#include "novaphy/dynamics/articulation/rotation_vector.h"

namespace novaphy::articulation {

// Number of bodies of an actuator: its body, the reference body, and the common ancestor.
inline constexpr int32_t kPushed = 3;

// Pose and motion of a body at the start of a step. The default is the world.
struct PushedBody {
  Transform<DualFloat> pose = Transform<DualFloat>::identity();
  SpatialVector<DualFloat> motion = zero_spatial<DualFloat>();  // velocity of the center of mass
  Vec3<DualFloat> com = {0.0f, 0.0f, 0.0f};                     // body frame
};
// Number of values of a body: position, quaternion, velocity, angular velocity, center of mass.
inline constexpr int32_t kPushedNumbers = 16;
inline DualFloat& number_of(PushedBody& b, int32_t k) {
  DualFloat* const all[kPushedNumbers] = {&b.pose.p.x,
                                          &b.pose.p.y,
                                          &b.pose.p.z,
                                          &b.pose.q.x,
                                          &b.pose.q.y,
                                          &b.pose.q.z,
                                          &b.pose.q.w,
                                          &b.motion.linear.x,
                                          &b.motion.linear.y,
                                          &b.motion.linear.z,
                                          &b.motion.angular.x,
                                          &b.motion.angular.y,
                                          &b.motion.angular.z,
                                          &b.com.x,
                                          &b.com.y,
                                          &b.com.z};
  return *all[k];
}
template <class T>
PushedBody pushed_body(const Transform<T>& x, const SpatialVector<T>& v, const Vec3<T>& com) {
  const T numbers[kPushedNumbers] = {
      x.p.x,      x.p.y,      x.p.z,       x.q.x,       x.q.y,       x.q.z, x.q.w, v.linear.x,
      v.linear.y, v.linear.z, v.angular.x, v.angular.y, v.angular.z, com.x, com.y, com.z};
  PushedBody b;
  for (int32_t k = 0; k < kPushedNumbers; ++k) number_of(b, k) = DualFloat(numbers[k]);
  return b;
}

// The frame of an actuator, in world axes.
struct PushedFrame {
  Vec3<DualFloat> arm, position, velocity;  // arm: from the center of mass
  Quat<DualFloat> q;
  PushedFrame(const PushedBody& b, const Transformf& in_body) {
    q = math::multiply(b.pose.q, constant(in_body.q));
    const Vec3<DualFloat> at = math::rotate(b.pose.q, constant(in_body.p));
    arm = at - math::rotate(b.pose.q, b.com);
    position = b.pose.p + at;
    velocity = b.motion.linear + math::cross(b.motion.angular, arm);
  }
};

// Calls put(which, wrench) with the wrench on each of the three bodies: the force, and the moment
// about the center of mass. Returns the actuator force. `input`: control or activation of the
// actuator. number(input, row, k): as for actuate.
template <class Number, class Put>
DualFloat push_bodies(const PushedBody (&bodies)[kPushed], const Transformf& frame,
                      const Transformf& reference, int32_t axes, int32_t actuator,
                      const DualFloat& input, const Number& number, const Put& put) {
  const PushedFrame a(bodies[0], frame), b(bodies[1], reference);
  const auto gear = [&](int32_t k) {
    return Vec3<DualFloat>{number(kWrench, actuator, k), number(kWrench, actuator, k + 1),
                           number(kWrench, actuator, k + 2)};
  };
  const Vec3<DualFloat> force = gear(0), moment = gear(3);
  const Vec3<DualFloat> along = math::rotate((axes & 1) != 0 ? b.q : a.q, force);
  const Vec3<DualFloat> about = math::rotate((axes & 2) != 0 ? b.q : a.q, moment);
  const Vec3<DualFloat> apart = a.position - b.position, pair = math::cross(apart, along);
  DualFloat length = 0.0f;
  if ((axes & 4) != 0)
    length = math::dot(force, math::rotate_inverse(b.q, apart)) +
             math::dot(moment, rotation_vector(math::multiply(math::conjugate(b.q), a.q)));
  const DualFloat rate = math::dot(along, a.velocity - b.velocity) +
                         math::dot(about, bodies[0].motion.angular - bodies[1].motion.angular) -
                         math::dot(bodies[2].motion.angular, pair);
  const ActuatorForce law = actuator_force(actuator, input, number);
  const DualFloat f =
      clipped(law.part + law.by_length * length + law.by_rate * rate, law.lower, law.upper);
  put(0, SpatialVector<DualFloat>{along * f, (about + math::cross(a.arm, along)) * f});
  put(1, -SpatialVector<DualFloat>{along * f, (about + math::cross(b.arm, along)) * f});
  put(2, -SpatialVector<DualFloat>{zero_spatial<DualFloat>().linear, pair * f});
  return f;
}

}  // namespace novaphy::articulation
