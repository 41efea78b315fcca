// The contacts of a box, sphere or capsule of a body with a plane of the world, as one formula. The
// formula selects points of the shape, computes the force of rigid_contact_trace.h at each point,
// and adds the wrenches in order.
//
// Points: the center of a sphere, the ends of a capsule (+z first), and the four deepest corners of
// a box. Order and selection of corners are those of geometry::Box::on_plane
// (collision/geometry/plane_pairs.h). X is the pose of the shape and n the normal of the plane. The
// contact of a point p of the shape is at P = X p - n (radius + margin), with the gap
//   d = dot(n, P - p_plane) - margin_plane
// With five or more corners below the plane the fifth deepest has no force.
//
// Gradient: exact for the selected points, in the pose, twist and center of mass of the body and in
// the materials. The comparisons that select corners have no gradient. The plane, and the size, the
// pose in the body and the margins of shapes, have no gradient either.
//
// Freestanding: T = float for tests, T = nova::Real is traced. No branch depends on a value.
#pragma once

#include "novaphy/dynamics/semi_implicit/rigid_contact_trace.h"

namespace novaphy {

template <class T>
struct WorldPlane {
  Vec3<T> point{}, normal{};
  T margin{};
};

template <class B, class T>
struct BodyShape {
  B is_box, is_capsule;  // neither: a sphere
  Transform<T> xform{};  // pose in the body
  Vec3<T> scale{};
  T margin{};
};

template <class T>
struct BodyMotion {
  Transform<T> pose{};
  SpatialVector<T> twist{};
  Vec3<T> com{};
};

// Up to four corners of a box, in the box's frame.
template <class T>
struct CornerSlots {
  Vec3<T> corner[4];
  T distance[4];
  T count{};
};

// Returns the four deepest of the corners that are at most `reach` (m) above the plane. `box`: pose
// in the world.
template <class T>
CornerSlots<T> deepest_corners(const WorldPlane<T>& plane, const Transform<T>& box,
                               const Vec3<T>& half, const T& reach) {
  using namespace math;
  const T zero = T(0.0f), one = T(1.0f);
  const Vec3<T> ex = rotate(box.q, Vec3<T>{one, zero, zero});
  const Vec3<T> ey = rotate(box.q, Vec3<T>{zero, one, zero});
  const Vec3<T> ez = rotate(box.q, Vec3<T>{zero, zero, one});
  const T center = dot(box.p - plane.point, plane.normal);
  CornerSlots<T> kept;
  for (int j = 0; j < 4; ++j) {
    kept.corner[j] = {zero, zero, zero};
    kept.distance[j] = zero;
  }
  kept.count = zero;
  T highest = zero, highest_distance = zero;  // the entry that a deeper corner replaces
  for (int k = 0; k < 8; ++k) {
    const Vec3<T> corner = {(k & 1) != 0 ? half.x : -half.x, (k & 2) != 0 ? half.y : -half.y,
                            (k & 4) != 0 ? half.z : -half.z};
    const T d = center + dot(plane.normal, (ex * corner.x + ey * corner.y) + ez * corner.z);
    const auto within = negate(d > reach);
    const auto appends = both(within, kept.count < T(4.0f));
    const auto replaces = both(both(within, kept.count == T(4.0f)), d < highest_distance);
    for (int j = 0; j < 4 && j <= k; ++j) {
      const T slot = T(static_cast<float>(j));
      auto takes = both(appends, kept.count == slot);
      if (k >= 4) takes = either(takes, both(replaces, highest == slot));
      kept.corner[j] = select(takes, corner, kept.corner[j]);
      kept.distance[j] = select(takes, d, kept.distance[j]);
    }
    const auto is_higher = both(appends, either(kept.count == zero, d > highest_distance));
    highest = select(is_higher, kept.count, highest);
    highest_distance = select(is_higher, d, highest_distance);
    if (k >= 4) {
      T slot = zero, distance = kept.distance[0];
      for (int j = 1; j < 4; ++j) {
        const auto higher = kept.distance[j] > distance;
        slot = select(higher, T(static_cast<float>(j)), slot);
        distance = select(higher, kept.distance[j], distance);
      }
      highest = select(replaces, slot, highest);
      highest_distance = select(replaces, distance, highest_distance);
    }
    kept.count = select(appends, kept.count + one, kept.count);
  }
  return kept;
}

// Returns the wrench on the body about its center of mass. `material`: mean over both shapes.
// `gap`: sum over both shapes (m).
template <class B, class T>
SpatialVector<T> plane_contact_wrench(FrictionLaw law, const WorldPlane<T>& plane,
                                      const BodyShape<B, T>& shape, const BodyMotion<T>& body,
                                      const T& gap, const RigidContactMaterial<T>& material,
                                      const T& smoothing) {
  using namespace math;
  const T zero = T(0.0f), none = T(-0.0f);
  const auto constant = [](const Transform<T>& x) {
    return Transform<T>{{detach(x.p.x), detach(x.p.y), detach(x.p.z)},
                        {detach(x.q.x), detach(x.q.y), detach(x.q.z), detach(x.q.w)}};
  };
  const CornerSlots<T> corners = deepest_corners(plane, multiply(constant(body.pose), shape.xform),
                                                 shape.scale, (gap + plane.margin) + shape.margin);
  const Vec3<T> n = -plane.normal;
  const Vec3<T> on_plane = plane.point - n * plane.margin;
  const Vec3<T> com = transform_point(body.pose, body.com);
  const T beyond = select(shape.is_box, zero, shape.scale.x) + shape.margin;
  SpatialVector<T> sum;
  for (int j = 0; j < 4; ++j) {
    const T end = select(shape.is_capsule, j == 0 ? shape.scale.y : -shape.scale.y, zero);
    const Vec3<T> local = select(shape.is_box, corners.corner[j], Vec3<T>{zero, zero, end});
    const Vec3<T> point =
        transform_point(body.pose, transform_point(shape.xform, local)) + n * beyond;
    // An end of a capsule is a contact if it is within the gap, as in the search. Selected corners
    // are always contacts.
    const auto near = negate(gap < dot(n, on_plane - point));
    auto present = both(shape.is_box, corners.count > T(static_cast<float>(j)));
    if (j == 0) present = either(present, both(near, negate(shape.is_box)));
    if (j == 1) present = either(present, both(near, shape.is_capsule));
    const Vec3<T> arm = point - com;
    const Vec3<T> u = -(body.twist.linear + cross(body.twist.angular, arm));
    const Vec3<T> f = rigid_contact_law({law, smoothing}, n, on_plane, point, u, material);
    const SpatialVector<T> wrench = {select(present, f, Vec3<T>{none, none, none}),
                                     select(present, cross(arm, f), Vec3<T>{none, none, none})};
    sum = j == 0 ? wrench
                 : SpatialVector<T>{sum.linear + wrench.linear, sum.angular + wrench.angular};
  }
  return sum;
}

}  // namespace novaphy
