// Moving contact points of trees: the derivative of the surface points and the normal by the poses
// of the two bodies, by the closed forms of moving_contact_trace.h.
//
// A common motion of both bodies carries points and normal along. The law is therefore
// differentiated by the motion of B relative to A only (six directions):
//   da = motion of A at a + sum_i a_i x_i,   x = twist of B - twist of A at the midpoint
// and likewise db, and dn with the rotation of A. The gap d = n . (b - a) has dd = n . (db - da).
// Freestanding: shared by the host and device kernels.
#pragma once

#include "novaphy/core/sim/enums.h"
#include "novaphy/dynamics/articulation/contact_rows.h"
#include "novaphy/dynamics/semi_implicit/moving_contact_trace.h"

// A separate namespace, so that argument-dependent lookup finds no function of articulations.
namespace novaphy::by_twist {

// A number with its derivatives by a twist.
struct ByTwist {
  float value = 0.0f;
  float by[6] = {};
  ByTwist() = default;
  explicit ByTwist(float v) : value(v) {}

  // f(i): derivative by component i.
  template <class F>
  static ByTwist make(float value, const F& f) {
    ByTwist to(value);
    for (int i = 0; i < 6; ++i) to.by[i] = f(i);
    return to;
  }
  friend ByTwist operator+(const ByTwist& a, const ByTwist& b) {
    return make(a.value + b.value, [&](int i) { return a.by[i] + b.by[i]; });
  }
  friend ByTwist operator-(const ByTwist& a, const ByTwist& b) {
    return make(a.value - b.value, [&](int i) { return a.by[i] - b.by[i]; });
  }
  friend ByTwist operator-(const ByTwist& a) {
    return make(-a.value, [&](int i) { return -a.by[i]; });
  }
  friend ByTwist operator*(const ByTwist& a, const ByTwist& b) {
    return make(a.value * b.value, [&](int i) { return a.by[i] * b.value + a.value * b.by[i]; });
  }
  friend ByTwist operator/(const ByTwist& a, const ByTwist& b) {
    const float q = a.value / b.value;
    return make(q, [&](int i) { return (a.by[i] - q * b.by[i]) / b.value; });
  }
  friend bool operator<(const ByTwist& a, const ByTwist& b) { return a.value < b.value; }
  friend bool operator>(const ByTwist& a, const ByTwist& b) { return a.value > b.value; }
  friend bool operator<=(const ByTwist& a, const ByTwist& b) { return a.value <= b.value; }
  friend bool operator>=(const ByTwist& a, const ByTwist& b) { return a.value >= b.value; }
  friend ByTwist select(bool c, const ByTwist& a, const ByTwist& b) { return c ? a : b; }
  friend ByTwist abs(const ByTwist& a) { return a.value < 0.0f ? -a : a; }
  friend ByTwist max(const ByTwist& a, const ByTwist& b) { return a.value >= b.value ? a : b; }
  friend ByTwist sqrt(const ByTwist& a) {
    const float r = math::sqrt(a.value);
    return make(r, [&](int i) { return a.by[i] / (r + r); });
  }
  friend ByTwist detach(const ByTwist& a) { return ByTwist(a.value); }
  friend ByTwist with_derivative(const ByTwist& y, const ByTwist& x, const ByTwist& by_x) {
    return make(y.value, [&](int i) { return y.by[i] + by_x.value * x.by[i]; });
  }
};

}  // namespace novaphy::by_twist

namespace novaphy::articulation {

using by_twist::ByTwist;

// The shape arrays of a model.
struct TurningShapes {
  const int32_t* type;
  const Transformf* pose;  // pose in the body
  const Vec3f* scale;
};
// A contact as it was found, and the poses of its bodies relative to one origin.
template <class T>
struct TurningInput {
  int32_t shape[2];
  Vec3f point[2], normal;  // points in body frames; normal in the world
  Transform<T> pose[2];
};

template <class T>
NOVAPHY_SELDOM MovingContact<bool, T> turn_contact(const TurningShapes& shapes,
                                                   const TurningInput<T>& of) {
  const auto lift = [](const Vec3f& v) { return Vec3<T>{T(v.x), T(v.y), T(v.z)}; };
  const Vec3<T> normal = lift(of.normal);
  Vec3<T> world[2];
  for (int side = 0; side < 2; ++side)
    world[side] = math::transform_point(of.pose[side], lift(of.point[side]));
  const auto feature = [&](int side) {
    const int32_t shape = of.shape[side];
    const auto is = [&](GeoType wanted) {
      return shapes.type[shape] == static_cast<int32_t>(wanted);
    };
    const Transformf& at = shapes.pose[shape];
    const Transform<T> pose = {lift(at.p), {T(at.q.x), T(at.q.y), T(at.q.z), T(at.q.w)}};
    const auto own = contact_shape<GeoType, bool, T>(is, pose, lift(shapes.scale[shape]));
    return contact_feature_of(own, of.pose[side], lift(of.point[side]), world[1 - side], normal,
                              side == 0);
  };
  return moving_contact(feature(0), feature(1), normal);
}

// a_i, b_i and n_i of the head comment.
struct ContactTurning {
  bool is_exact = false;
  Vec3f a[6] = {}, b[6] = {}, normal[6] = {};
};

// Returns the pose of body B with its derivatives by a twist about `at`.
inline Transform<ByTwist> moving_pose(const Transformf& pose, const Vec3f& at) {
  const Vec3f arm = pose.p - at;
  Transform<ByTwist> to;
  const auto number = [](float value, float x, float y, float z, float rx, float ry, float rz) {
    const float by[6] = {x, y, z, rx, ry, rz};
    return ByTwist::make(value, [&](int i) { return by[i]; });
  };
  to.p = {number(pose.p.x, 1.0f, 0.0f, 0.0f, 0.0f, arm.z, -arm.y),
          number(pose.p.y, 0.0f, 1.0f, 0.0f, -arm.z, 0.0f, arm.x),
          number(pose.p.z, 0.0f, 0.0f, 1.0f, arm.y, -arm.x, 0.0f)};
  const Quatf h = {0.5f * pose.q.x, 0.5f * pose.q.y, 0.5f * pose.q.z, 0.5f * pose.q.w};
  const float o = 0.0f;
  to.q = {number(pose.q.x, o, o, o, h.w, h.z, -h.y), number(pose.q.y, o, o, o, -h.z, h.w, h.x),
          number(pose.q.z, o, o, o, h.y, -h.x, h.w), number(pose.q.w, o, o, o, -h.x, -h.y, -h.z)};
  return to;
}
inline Transform<ByTwist> resting_pose(const Transformf& pose) {
  return {{ByTwist(pose.p.x), ByTwist(pose.p.y), ByTwist(pose.p.z)},
          {ByTwist(pose.q.x), ByTwist(pose.q.y), ByTwist(pose.q.z), ByTwist(pose.q.w)}};
}

// `margins`: distances from the cores to the surfaces, along the normal. `at`: the midpoint.
NOVAPHY_SELDOM inline ContactTurning contact_turning(const TurningShapes& shapes,
                                                     const TurningInput<float>& of,
                                                     const float* margins, const Vec3f& at) {
  const TurningInput<ByTwist> moving = {{of.shape[0], of.shape[1]},
                                        {of.point[0], of.point[1]},
                                        of.normal,
                                        {resting_pose(of.pose[0]), moving_pose(of.pose[1], at)}};
  const MovingContact<bool, ByTwist> c = turn_contact(shapes, moving);
  ContactTurning to;
  to.is_exact = c.is_exact;
  for (int i = 0; c.is_exact && i < 6; ++i) {
    to.normal[i] = {c.normal.x.by[i], c.normal.y.by[i], c.normal.z.by[i]};
    to.a[i] = Vec3f{c.a.x.by[i], c.a.y.by[i], c.a.z.by[i]} + to.normal[i] * margins[0];
    to.b[i] = Vec3f{c.b.x.by[i], c.b.y.by[i], c.b.z.by[i]} + to.normal[i] * margins[1];
  }
  return to;
}

// Returns the rotation of contact_frame about the normal, per change of the normal.
inline Vec3f frame_spin(const ContactFrame<float>& frame) {
  const Vec3f n = frame.axes[0];
  const float x = math::abs(n.x), y = math::abs(n.y), z = math::abs(n.z);
  const bool along_x = !(y < x) && !(z < x), along_y = !along_x && !(z < y);
  const float part = along_x ? n.x : (along_y ? n.y : n.z);
  return frame.axes[1] * (-part / math::sqrt(1.0f - part * part));
}

// Converts gradients by the points and the normal of a contact to forces and torques at the
// midpoint on the poses of A and B. `by_point`: gradient by the midpoint. `by_axes`: by the axes of
// the frame. `by_gap`: by the gap.
struct TurningPulls {
  SpatialVectorf on[2] = {};
};
inline TurningPulls turning_pulls(const ContactTurning& of, const ContactFrame<float>& frame,
                                  const Vec3f& by_point, const Vec3f (&by_axes)[3], float by_gap) {
  const Vec3f n = frame.axes[0];
  Vec3f torque{};
  for (int r = 0; r < 3; ++r) torque = torque + math::cross(frame.axes[r], by_axes[r]);
  const Vec3f by_normal = math::cross(torque, n) + frame_spin(frame) * math::dot(n, torque);
  const Vec3f by_a = by_point * 0.5f - n * by_gap, by_b = by_point * 0.5f + n * by_gap;
  float relative[6];
  for (int i = 0; i < 6; ++i)
    relative[i] =
        (math::dot(by_a, of.a[i]) + math::dot(by_b, of.b[i])) + math::dot(by_normal, of.normal[i]);
  TurningPulls to;
  to.on[1] = {{relative[0], relative[1], relative[2]}, {relative[3], relative[4], relative[5]}};
  to.on[0] = {by_point - to.on[1].linear, math::cross(n, by_normal) - to.on[1].angular};
  return to;
}

// The motion of the surface points and the normal for twists of A and B at the midpoint.
// `half_gap`: from the midpoint to b along the normal.
struct TurningMotion {
  Vec3f a, b, normal;
};
inline TurningMotion turning_motion(const ContactTurning& of, const Vec3f& normal, float half_gap,
                                    const SpatialVectorf (&twists)[2]) {
  const Vec3f linear = twists[1].linear - twists[0].linear,
              angular = twists[1].angular - twists[0].angular;
  const float x[6] = {linear.x, linear.y, linear.z, angular.x, angular.y, angular.z};
  TurningMotion to;
  to.normal = math::cross(twists[0].angular, normal);
  to.a = twists[0].linear - to.normal * half_gap;
  to.b = twists[0].linear + to.normal * half_gap;
  for (int i = 0; i < 6; ++i) {
    to.a = to.a + of.a[i] * x[i];
    to.b = to.b + of.b[i] * x[i];
    to.normal = to.normal + of.normal[i] * x[i];
  }
  return to;
}

}  // namespace novaphy::articulation
