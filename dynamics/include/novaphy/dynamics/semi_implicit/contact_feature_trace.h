// The feature of a shape at the point of a rigid contact: what moving_contact_trace.h needs to know
// of one side of a contact.
//
// The search stores points of the cores in the frames of the bodies, and a normal in the world. The
// position of a point identifies the feature of its shape:
//   sphere           the center: a point
//   capsule          an end: a point; between: a line along z
//   plane            a face
//   box              on three faces: a point (corner), on two: a line (edge), on one: flat
//   cylinder, cone   on the rim: the deepest point, which moves along the rim, or one of three
//                    fixed points; the apex: a point
//   ellipsoid        the deepest point, which moves over the surface
//   hull, mesh       a vertex: a point, for contacts with planes. A hull has this point also for
//                    contacts with faces of boxes. For contacts with other shapes, the caller
//                    gives the feature.
//
// Freestanding: T = float tests which contacts are exact, T = nova::Real is traced.
#pragma once

#include "novaphy/dynamics/semi_implicit/witness_points_trace.h"
#include "novaphy/math/types.h"

namespace novaphy {

// The feature of a hull or a mesh at a point (collision/geometry/polytope_feature.h). Frame of the
// shape. No flag set: unknown, or another shape.
template <class B, class T>
struct PolytopeSide {
  B is_face{}, is_edge{}, is_corner{}, leads{}, is_along{};
  Vec3<T> line{}, clips{};
  T aside{};
};

// The type, pose and scale of a shape. B is bool or nova::Bool. No flag set: another type.
template <class B, class T>
struct ContactShape {
  B is_plane{}, is_sphere{}, is_capsule{}, is_box{}, is_ellipsoid{}, is_cylinder{}, is_cone{},
      is_hull{}, is_polytope{};
  Transform<T> pose{};  // in the body's frame
  Vec3<T> scale{};      // see GeoType
  PolytopeSide<B, T> polytope{};
};
// Makes a shape. is(type): whether the shape has this type. Type is GeoType as a template argument,
// because files of formulas do not include its header.
template <class Type, class B, class T, class Is>
ContactShape<B, T> contact_shape(const Is& is, const Transform<T>& pose, const Vec3<T>& scale) {
  using math::either;
  return {is(Type::PLANE),
          is(Type::SPHERE),
          is(Type::CAPSULE),
          is(Type::BOX),
          is(Type::ELLIPSOID),
          is(Type::CYLINDER),
          is(Type::CONE),
          is(Type::CONVEX_MESH),
          either(is(Type::CONVEX_MESH), is(Type::MESH)),
          pose,
          scale,
          {}};
}

// The feature of a shape at a contact point. Directions are unit vectors in the world.
template <class B, class T>
struct ContactFeature {
  Vec3<T> point{};
  B is_known{}, is_point{}, is_line{}, is_flat{};
  Vec3<T> line{}, flat{};
  // The face that is closest to the normal: whether the normal is along it, whether the point is on
  // it, the face's normal, and the cosine between that and the contact normal.
  B is_along{}, is_on_face{};
  Vec3<T> face{};
  T cosine{};
  // The other shape's point, fixed in this shape, and the sides of that face that it is on.
  Vec3<T> held{}, side{};
  B has_side{}, has_corner{};
  // The edge (or the axis of a capsule) that the normal is perpendicular to.
  B has_across{};
  Vec3<T> across{};
  B is_box{}, is_capsule{}, is_corner{};
  Vec3<T> far_end{};  // the other end of a capsule whose end touches
  // For contacts with faces: whether the shape is a plane, whether its feature can touch planes or
  // faces of boxes, and whether the point is fixed to the shape.
  B is_plane{}, meets_planes{}, meets_faces{}, is_fixed{};
  // The feature is the deepest point of an ellipsoid, whose orientation is `turn`. direction: 1
  // along the normal, -1 against the normal. A box has the same center, half axes and orientation.
  B is_deepest{};
  Vec3<T> center{}, half_axes{};
  T direction{};
  Quat<T> turn{};
  WitnessSide<B, T> witness{};
};

// Returns the deepest point of a shape with f.is_deepest.
template <class B, class T>
Vec3<T> deepest_point(const ContactFeature<B, T>& f, const Vec3<T>& normal) {
  using namespace math;
  const Vec3<T> m = rotate_inverse(f.turn, normal), h = f.half_axes;
  const Vec3<T> d = {h.x * m.x, h.y * m.y, h.z * m.z};
  const T square = dot(d, d);
  const T scale = f.direction / sqrt(select(square > T(0.0f), square, T(1.0f)));
  return f.center +
         rotate(f.turn, Vec3<T>{h.x * d.x * scale, h.y * d.y * scale, h.z * d.z * scale});
}

// Sets the members for contacts with faces. `x`, `n`: point and normal in the frame of the shape.
template <class B, class T>
void set_deepest(ContactFeature<B, T>& f, const ContactShape<B, T>& shape, const Vec3<T>& x,
                 const Vec3<T>& n) {
  using namespace math;
  const T zero = T(0.0f);
  const Vec3<T> h = shape.scale;
  // Rims: the deepest point lies in the direction of the normal that points out.
  const auto has_rim = either(shape.is_cylinder, shape.is_cone);
  const T across = sqrt(n.x * n.x + n.y * n.y), reach = across * h.x;
  const T off_side = abs(x.x * n.y - x.y * n.x), down = f.direction * (x.x * n.x + x.y * n.y);
  const auto apex = both(shape.is_cone, x.z > zero);
  const auto flat = both(has_rim, both(negate(apex), across < T(1e-4f)));
  const auto at_deepest = both(down > zero, off_side <= reach * T(1e-3f));
  f.is_deepest =
      either(shape.is_ellipsoid, both(both(has_rim, negate(apex)), both(negate(flat), at_deepest)));
  f.is_fixed = either(shape.is_polytope, both(has_rim, both(negate(flat), negate(f.is_deepest))));
  f.is_plane = shape.is_plane;
  f.meets_planes = either(shape.is_ellipsoid, either(has_rim, shape.is_polytope));
  // The face of a box decides the normal if a base is almost parallel to it (clip_manifold.h). A
  // point inside of a base comes from a search that has not converged.
  const auto at_corner = either(apex, both(either(shape.is_cone, across > T(0.015f)),
                                           x.x * x.x + x.y * x.y >= h.x * h.x * T(1.0f - 2e-4f)));
  f.meets_faces = either(shape.is_hull, both(has_rim, at_corner));
}

// Sets the type of the shape and the members that describe its size and orientation. `x`: the point
// in the frame of the shape.
template <class B, class T>
void set_sizes(ContactFeature<B, T>& f, const ContactShape<B, T>& shape, const Transform<T>& body,
               const Vec3<T>& x) {
  using namespace math;
  const T zero = T(0.0f);
  const Vec3<T> h = shape.scale, none = {zero, zero, zero};
  const Transform<T> from_shape = multiply(body, shape.pose);
  f.is_known =
      either(either(shape.is_plane, shape.is_sphere), either(shape.is_capsule, shape.is_box));
  f.turn = multiply(body.q, shape.pose.q);
  f.is_box = shape.is_box;
  f.is_capsule = shape.is_capsule;
  const auto has_three = either(shape.is_ellipsoid, shape.is_box);
  f.half_axes = {h.x, select(has_three, h.y, h.x), select(has_three, h.z, zero)};
  f.center = transform_point(from_shape, select(has_three, none, Vec3<T>{zero, zero, x.z}));
  f.far_end = transform_point(from_shape, Vec3<T>{zero, zero, -x.z});
}

// Returns a point of the world in the frame of a body, as a constant.
template <class T>
Vec3<T> fixed_in_body(const Transform<T>& body, const Vec3<T>& point) {
  using namespace math;
  const Transform<T> still = {
      {detach(body.p.x), detach(body.p.y), detach(body.p.z)},
      {detach(body.q.x), detach(body.q.y), detach(body.q.z), detach(body.q.w)}};
  return transform_point(inverse(still),
                         Vec3<T>{detach(point.x), detach(point.y), detach(point.z)});
}

// Returns 1 for the largest component of m, and 0 for the others.
template <class T>
Vec3<T> largest_component(const Vec3<T>& m) {
  using namespace math;
  const T zero = T(0.0f), one = T(1.0f);
  const auto first = both(m.x >= m.y, m.x >= m.z), second = m.y >= m.z;
  return {select(first, one, zero), select(both(negate(first), second), one, zero),
          select(both(negate(first), negate(second)), one, zero)};
}

// Finds the feature of a shape's contact point. `other`: the other shape's point, in the world.
// `is_a`: whether the normal points out of this shape.
template <class B, class T>
ContactFeature<B, T> contact_feature_of(const ContactShape<B, T>& shape, const Transform<T>& body,
                                        const Vec3<T>& body_point, const Vec3<T>& other,
                                        const Vec3<T>& normal, bool is_a) {
  using namespace math;
  constexpr float kOn = 1e-4f, kZero = 1e-4f, kNearFace = 20.0f;
  const T zero = T(0.0f), one = T(1.0f), half = T(0.5f);
  const Vec3<T> body_other = fixed_in_body(body, other);
  const Transform<T> to_shape = inverse(shape.pose);
  const Vec3<T> x = transform_point(to_shape, body_point),
                y = transform_point(to_shape, body_other);
  ContactFeature<B, T> f;
  set_sizes(f, shape, body, x);
  const Vec3<T> n = rotate_inverse(f.turn, normal), m = {abs(n.x), abs(n.y), abs(n.z)};
  const Vec3<T> h = shape.scale;
  const T size = max(h.x, max(h.y, h.z)) * T(kOn);
  const auto flag = [&](const auto& is) { return select(is, one, zero); };
  // 1 for each face of a box that a point is on.
  const auto on = [&](const T& at, const T& extent) {
    return flag(both(shape.is_box, abs(abs(at) - extent) <= size));
  };
  const Vec3<T> faces = {on(x.x, h.x), on(x.y, h.y), on(x.z, h.z)};
  const Vec3<T> others = {on(y.x, h.x), on(y.y, h.y), on(y.z, h.z)};
  const Vec3<T> looks = largest_component(m);  // the axis of the face closest to the normal
  const Vec3<T> sides = {others.x * (one - looks.x), others.y * (one - looks.y),
                         others.z * (one - looks.z)};
  const Vec3<T> none = {flag(m.x < T(kZero)), flag(m.y < T(kZero)), flag(m.z < T(kZero))};
  const auto sum = [](const Vec3<T>& v) { return (v.x + v.y) + v.z; };
  const auto is = [&](const T& count, float number) { return abs(count - T(number)) < half; };
  const T count = sum(faces);
  const Vec3<T> up = {zero, zero, one};
  const auto at_end = abs(x.z) >= h.y - (h.x + h.y) * T(kOn);
  const auto world = [&](const Vec3<T>& v) { return rotate(f.turn, v); };
  f.point = transform_point(body, body_point);
  f.is_point = either(either(shape.is_sphere, both(shape.is_capsule, at_end)),
                      both(shape.is_box, is(count, 3.0f)));
  f.is_line = either(both(shape.is_capsule, negate(at_end)), both(shape.is_box, is(count, 2.0f)));
  f.is_flat = both(shape.is_box, is(count, 1.0f));
  f.line =
      world(select(shape.is_capsule, up, Vec3<T>{one - faces.x, one - faces.y, one - faces.z}));
  f.flat = world(faces);
  f.is_along = either(shape.is_plane, both(shape.is_box, is(sum(none), 2.0f)));
  const T off = abs((abs(dot(x, looks)) - dot(h, looks)));
  f.is_on_face = either(shape.is_plane, both(shape.is_box, off <= size * T(kNearFace)));
  f.face = world(select(shape.is_plane, up, looks));
  f.cosine = select(f.is_on_face, select(shape.is_plane, T(2.0f), dot(m, looks)), -one);
  f.held = transform_point(body, body_other);
  f.side = world(sides);
  f.has_side = is(sum(sides), 1.0f);
  f.has_corner = is(sum(sides), 2.0f);
  f.has_across =
      either(both(shape.is_box, is(sum(none), 1.0f)), both(shape.is_capsule, none.z > half));
  f.across = world(select(shape.is_capsule, up, none));
  f.is_corner = both(shape.is_box, f.is_point);
  f.direction = is_a ? one : -one;
  set_deepest(f, shape, x, n);
  f.witness = witness_side(shape, body, body_point, normal, f);
  return f;
}

}  // namespace novaphy
