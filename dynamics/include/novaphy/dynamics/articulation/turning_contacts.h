// Moving contact points of trees: the derivative of the surface points and the normal by the poses
// of the two bodies, from the closed forms of moving_contact_trace.h.
//
// A common motion of both bodies also moves points and normal. So the contact law is differentiated
// only by the motion of B relative to A, along six twists x_i:
//   da = motion of A at a + sum_i a_i x_i,   x = twist of B - twist of A at the midpoint
// The formulas for db, and for dn with the rotation of A, are alike. The gap d = n . (b - a) has dd
// = n . (db - da). Freestanding: shared by host and device kernels.
#pragma once

#include "novaphy/collision/geometry/polytope_feature.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/dynamics/articulation/contact_rows.h"
#include "novaphy/dynamics/semi_implicit/moving_contact_trace.h"

// A separate namespace, so that argument-dependent lookup finds no function of articulations.
namespace novaphy::by_twist {

// A number with its derivatives along n twists (forward-mode automatic differentiation).
template <int n>
struct ByTwist {
  float value = 0.0f;
  float by[n] = {};
  ByTwist() = default;
  explicit ByTwist(float v) : value(v) {}

  // Makes a number. f(i): its derivative along twist i.
  template <class F>
  static ByTwist make(float value, const F& f) {
    ByTwist to(value);
    for (int i = 0; i < n; ++i) to.by[i] = f(i);
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
  const Transformf* pose;  // in the frame of the body
  const Vec3f* scale;
  // The tables of hulls and meshes, and the row of each shape in them. Null: unknown.
  const geometry::GeometryView* views = nullptr;
  const int32_t* view_of = nullptr;
};
// A contact as the search found it, and the poses of its bodies relative to a common origin.
template <class T>
struct TurningInput {
  int32_t shape[2];
  Vec3f point[2], normal;  // points in body frames; normal in the world
  Transform<T> pose[2];
  geometry::PolytopeFeature feature[2] = {};  // of hulls and meshes
};

// Finds the features of hulls and meshes at the points of a contact.
inline void find_polytopes(const TurningShapes& shapes, TurningInput<float>& of) {
  for (int side = 0; side < 2 && shapes.views != nullptr; ++side) {
    const int32_t view = shapes.view_of[of.shape[side]];
    if (view < 0) continue;
    const Transformf& own = shapes.pose[of.shape[side]];
    const Quatf turn = math::multiply(of.pose[side].q, own.q);
    of.feature[side] = geometry::polytope_feature(
        shapes.views[view], math::transform_point(math::inverse(own), of.point[side]),
        math::rotate_inverse(turn, of.normal));
  }
}

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
    auto own = contact_shape<GeoType, bool, T>(is, pose, lift(shapes.scale[shape]));
    const geometry::PolytopeFeature& f = of.feature[side];
    own.polytope = {f.is_face, f.is_edge, f.is_corner, f.leads,
                    f.is_along, lift(f.line), lift(f.clips), T(f.aside)};
    return contact_feature_of(own, of.pose[side], lift(of.point[side]), world[1 - side], normal,
                              side == 0);
  };
  return moving_contact(feature(0), feature(1), normal);
}

// The derivatives of a contact's points and normal along n twists of B relative to A.
template <int n>
struct Turning {
  bool is_exact = false;
  Vec3f a[n] = {}, b[n] = {}, normal[n] = {};
};
using ContactTurning = Turning<6>;  // a_i, b_i and n_i of the comment at the top

// Returns the pose of body B with its derivatives along twists about the point `at`.
template <int n>
Transform<ByTwist<n>> moving_pose(const Transformf& pose, const Vec3f& at,
                                  const SpatialVectorf (&twists)[n]) {
  Vec3f moved[n];
  Quatf turned[n];
  for (int i = 0; i < n; ++i) {
    const Vec3f w = twists[i].angular;
    moved[i] = twists[i].linear + math::cross(w, pose.p - at);
    turned[i] = math::multiply(Quatf{0.5f * w.x, 0.5f * w.y, 0.5f * w.z, 0.0f}, pose.q);
  }
  using To = ByTwist<n>;
  return {{To::make(pose.p.x, [&](int i) { return moved[i].x; }),
           To::make(pose.p.y, [&](int i) { return moved[i].y; }),
           To::make(pose.p.z, [&](int i) { return moved[i].z; })},
          {To::make(pose.q.x, [&](int i) { return turned[i].x; }),
           To::make(pose.q.y, [&](int i) { return turned[i].y; }),
           To::make(pose.q.z, [&](int i) { return turned[i].z; }),
           To::make(pose.q.w, [&](int i) { return turned[i].w; })}};
}
template <class T>
Transform<T> resting_pose(const Transformf& pose) {
  return {{T(pose.p.x), T(pose.p.y), T(pose.p.z)},
          {T(pose.q.x), T(pose.q.y), T(pose.q.z), T(pose.q.w)}};
}

// Returns the derivatives of a contact along the twists. `margins`: distances from the cores to the
// surfaces, along the normal (m). `at`: the midpoint.
template <int n>
NOVAPHY_SELDOM Turning<n> turning_along(const TurningShapes& shapes, const TurningInput<float>& of,
                                        const float* margins, const Vec3f& at,
                                        const SpatialVectorf (&twists)[n]) {
  const TurningInput<ByTwist<n>> moving = {
      {of.shape[0], of.shape[1]},
      {of.point[0], of.point[1]},
      of.normal,
      {resting_pose<ByTwist<n>>(of.pose[0]), moving_pose(of.pose[1], at, twists)},
      {of.feature[0], of.feature[1]}};
  const MovingContact<bool, ByTwist<n>> c = turn_contact(shapes, moving);
  Turning<n> to;
  to.is_exact = c.is_exact;
  for (int i = 0; c.is_exact && i < n; ++i) {
    to.normal[i] = {c.normal.x.by[i], c.normal.y.by[i], c.normal.z.by[i]};
    to.a[i] = Vec3f{c.a.x.by[i], c.a.y.by[i], c.a.z.by[i]} + to.normal[i] * margins[0];
    to.b[i] = Vec3f{c.b.x.by[i], c.b.y.by[i], c.b.z.by[i]} + to.normal[i] * margins[1];
  }
  return to;
}
inline ContactTurning contact_turning(const TurningShapes& shapes, const TurningInput<float>& of,
                                      const float* margins, const Vec3f& at) {
  const float axes[3][3] = {{1.0f, 0.0f, 0.0f}, {0.0f, 1.0f, 0.0f}, {0.0f, 0.0f, 1.0f}};
  ContactTurning to;
  NOVAPHY_ROLLED
  for (int first = 0; first < 6; first += kDirectionsAtOnce) {
    SpatialVectorf twists[kDirectionsAtOnce] = {};
    for (int i = 0; i < kDirectionsAtOnce; ++i) {
      const float* const axis = axes[(first + i) % 3];
      (first + i < 3 ? twists[i].linear : twists[i].angular) = {axis[0], axis[1], axis[2]};
    }
    const Turning<kDirectionsAtOnce> part = turning_along(shapes, of, margins, at, twists);
    to.is_exact = part.is_exact;
    for (int i = 0; i < kDirectionsAtOnce; ++i) {
      to.a[first + i] = part.a[i];
      to.b[first + i] = part.b[i];
      to.normal[first + i] = part.normal[i];
    }
  }
  return to;
}

// Returns the rotation of the tangents of contact_frame about the normal, per change of the normal.
inline Vec3f frame_spin(const ContactFrame<float>& frame) {
  const Vec3f n = frame.axes[0];
  const float x = math::abs(n.x), y = math::abs(n.y), z = math::abs(n.z);
  const bool along_x = !(y < x) && !(z < x), along_y = !along_x && !(z < y);
  const float part = along_x ? n.x : (along_y ? n.y : n.z);
  return frame.axes[1] * (-part / math::sqrt(1.0f - part * part));
}

// Gradients by the points and the normal of a contact, as a force and a torque at the midpoint on
// the poses of A and B. Inputs: the gradients by the midpoint (`by_point`), by the axes of the
// frame (`by_axes`) and by the gap (`by_gap`).
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

}  // namespace novaphy::articulation
