// Moving contact points: the derivative of the points and the normal of a rigid contact by the
// poses of its two bodies. A closed form exists for planes with all shapes, for spheres, capsules
// and boxes, and for cylinders, cones, ellipsoids, hulls and meshes (witness_points_trace.h).
//
// The position of a point identifies the feature of its shape (contact_feature_trace.h).
//
// Law. P and Q are points fixed in A and B. U, V are directions of lines and M normals of faces,
// which rotate with their bodies. The normal n points from A to B:
//   face      for a plane; for a face of a box along n; or for the leading face if n is
//             perpendicular to an edge of each of two boxes (or a box and a capsule):
//             n is M, or along the product of the two edges. The point of the other shape is a
//             corner, or the intersection of its line with a side of the box, or of the edge
//             between two sides of the box with its face, or the deepest point along n:
//             c + D^2 m/|D m|, m = n in the frame of the shape, c its center, D the half axes of
//             an ellipsoid, or (r, r, 0) of a rim. The face's point is this point moved along n
//   points    P, Q,  n along Q - P
//   point and line    the line's point is the nearest to the other shape's point
//   lines     their nearest points, n along U x V (if at least 0.6 degrees from parallel)
// All other contacts are frozen: points are constant in their bodies and the normal in the world.
// These contacts are frozen:
//
// - The normal is not that of this law (within 0.3 degrees).
// - The search chooses among features that coincide (within 1e-4 of a size or a direction).
//   Examples are a capsule that lies flat across an edge of a box's face, and a corner of a box on
//   the outline of another box's face. Further examples are two corners or ends with the normal
//   perpendicular to an edge or axis of each, and parallel faces of two boxes where the points lie
//   on the outlines of both.
// - A rim lies flat on a plane (within 1e-4) or on a face of a box (a cylinder within 0.9 degrees),
//   so its deepest point is not unique.
// - The feature of a hull or a mesh is not known, or the inside of a face meets a side of another
//   face: an edge that crosses the outline of a face, or a corner of that outline.
// - An ellipsoid, a cylinder or a cone touches a shape without faces in an area, at points that are
//   not the nearest ones.
//
// The values are the stored points and normal; the law only gives their derivatives. Gradient:
// exact by poses while the features stay the same. Shapes have no gradient.
//
// Freestanding: T = float tests which contacts are exact, T = nova::Real is traced.
#pragma once

#include "novaphy/dynamics/semi_implicit/contact_feature_trace.h"
#include "novaphy/dynamics/semi_implicit/rigid_contact_trace.h"
#include "novaphy/math/types.h"

namespace novaphy {

template <class B, class T>
struct MovingContact {
  Vec3<T> a{}, b{}, normal{};  // points of the cores, world
  B is_exact{};
};

namespace moving_contact_detail {

inline constexpr float kFacePreference = 1e-4f;  // equal to that of
                                                 // collision/geometry/clip_manifold.h

template <class T>
T nonzero(const T& x, const T& least) {
  using namespace math;
  return select(abs(x) > least, x, T(1.0f));
}
template <class T>
T side_of(const Vec3<T>& v, const Vec3<T>& normal) {
  using namespace math;
  return select(dot(v, normal) < T(0.0f), T(-1.0f), T(1.0f));
}
template <class T>
Vec3<T> derivative_of(const Vec3<T>& value, const Vec3<T>& live) {
  using namespace math;
  const T one = T(1.0f);
  return {with_derivative(detach(value.x), live.x, one),
          with_derivative(detach(value.y), live.y, one),
          with_derivative(detach(value.z), live.z, one)};
}

template <class T>
Vec3<T> unit_along(const Vec3<T>& v, const Vec3<T>& normal) {
  using namespace math;
  const T square = dot(v, v);
  const Vec3<T> unit = v / sqrt(select(square > T(1e-12f), square, T(1.0f)));
  return unit * side_of(unit, normal);
}

// The points of a face and of the other shape, for the normal n.
template <class B, class T>
struct FaceContact {
  Vec3<T> of_face{}, of_other{};
  B is_exact{};
};
template <class B, class T>
FaceContact<B, T> face_contact(const ContactFeature<B, T>& face, const ContactFeature<B, T>& other,
                               const Vec3<T>& n) {
  using namespace math;
  const T least = T(1e-3f);
  const T into_side = dot(face.side, other.line), into_flat = dot(other.flat, face.face),
          into_face = dot(face.face, n);
  const auto at_side = both(both(other.is_line, face.has_side), abs(into_side) > least);
  const auto at_corner = both(both(other.is_flat, face.has_corner), abs(into_flat) > least);
  const Vec3<T> on_line = other.point + other.line * (dot(face.side, face.held - other.point) /
                                                      nonzero(into_side, least));
  const Vec3<T> on_flat = face.held + face.face * (dot(other.flat, other.point - face.held) /
                                                   nonzero(into_flat, least));
  FaceContact<B, T> c;
  c.of_other = select(
      at_side, on_line,
      select(at_corner, on_flat, select(other.is_deepest, deepest_point(other, n), other.point)));
  // Whether the two edges perpendicular to n are the nearest features, instead of line and face.
  const T own = dot(cross(face.face, face.side), face.across),
          theirs = dot(other.line, other.across);
  const auto edges = both(both(at_side, both(face.has_across, other.has_across)),
                          both(abs(own) > T(0.99f), abs(theirs) > T(0.99f)));
  const Vec3<T> on_edge = face.held - face.face * dot(face.face, face.held - face.point);
  const T above = select(edges, dot(n, c.of_other - on_edge),
                         dot(face.face, c.of_other - face.point) / nonzero(into_face, least));
  c.of_face = c.of_other - n * above;
  c.is_exact = either(
      either(other.is_point, either(at_side, at_corner)),
      either(other.is_deepest, both(either(face.is_plane, other.meets_faces), other.is_fixed)));
  return c;
}

// Returns whether a hull, a mesh or a curved shape touches a plane, or the inside of a box's face.
template <class B, class T>
B stands_on(const ContactFeature<B, T>& face, const ContactFeature<B, T>& other) {
  using namespace math;
  const auto inside = both(both(face.is_box, both(face.is_along, face.is_on_face)),
                           negate(either(face.has_side, face.has_corner)));
  return either(both(face.is_plane, other.meets_planes), both(inside, other.meets_faces));
}

// Returns the nearest points of curved shapes, hulls and meshes if exact, else points and normal as
// constants.
template <class B, class T>
MovingContact<B, T> nearest_or_held(const ContactFeature<B, T>& a, const ContactFeature<B, T>& b,
                                    const Vec3<T>& normal, const B& other_law) {
  using namespace math;
  const auto w = witness_points(a.witness, b.witness, normal);
  const auto is_exact = both(negate(other_law), w.is_exact);
  return {select(is_exact, w.a, a.point), select(is_exact, w.b, b.point),
          select(is_exact, w.normal, normal), is_exact};
}

}  // namespace moving_contact_detail

// Returns whether an end of a capsule touches the inside of a box's face, and the other end is
// above the inside of this face. The face then gives the normal, however the capsule turns.
template <class B, class T>
B lies_within_face(const ContactFeature<B, T>& face, const ContactFeature<B, T>& capsule) {
  using namespace math;
  const T zero = T(0.0f), one = T(1.0f);
  const Vec3<T> at = rotate_inverse(face.turn, capsule.far_end - face.center), h = face.half_axes;
  const auto beside = [&](const T& x, const T& half) { return select(abs(x) < half, zero, one); };
  const T sides = (beside(at.x, h.x) + beside(at.y, h.y)) + beside(at.z, h.z);
  return both(both(capsule.is_point, negate(either(face.has_side, face.has_corner))),
              abs(sides - one) < T(0.5f));
}

// Returns whether the inside of a box's face touches a corner of another box. That face then gives
// the normal, also if a face of the other box is parallel to it.
template <class B, class T>
B holds_corner(const ContactFeature<B, T>& face, const ContactFeature<B, T>& corner) {
  using namespace math;
  return both(both(face.is_flat, face.is_along), corner.is_corner);
}

// Returns whether features of the two shapes coincide, so that the points do not show which feature
// the search chose.
template <class B, class T>
B features_coincide(const ContactFeature<B, T>& a, const ContactFeature<B, T>& b) {
  using namespace math;
  const auto flat_on = [](const ContactFeature<B, T>& face, const ContactFeature<B, T>& capsule) {
    return both(
        both(both(face.is_along, face.is_box), both(capsule.is_capsule, capsule.has_across)),
        negate(lies_within_face(face, capsule)));
  };
  const auto on_outline = [](const ContactFeature<B, T>& face, const ContactFeature<B, T>& corner) {
    return both(both(face.is_along, corner.is_corner), either(face.has_side, face.has_corner));
  };
  const auto ends = both(both(a.is_point, b.is_point), both(a.has_across, b.has_across));
  const auto faces = both(both(both(a.is_along, b.is_along), both(a.is_box, b.is_box)),
                          negate(either(holds_corner(a, b), holds_corner(b, a))));
  return either(either(either(ends, faces), either(flat_on(a, b), flat_on(b, a))),
                either(on_outline(a, b), on_outline(b, a)));
}

template <class B, class T>
MovingContact<B, T> moving_contact(const ContactFeature<B, T>& a, const ContactFeature<B, T>& b,
                                   const Vec3<T>& normal) {
  using namespace math;
  namespace d = moving_contact_detail;
  const T one = T(1.0f), close = T(0.99999f);
  const auto known = either(both(both(a.is_known, b.is_known), negate(features_coincide(a, b))),
                            either(d::stands_on(a, b), d::stands_on(b, a)));
  const auto face_leads = [&](const ContactFeature<B, T>& f) {
    return both(known, both(f.is_along, f.is_on_face));
  };
  const auto along_a = both(face_leads(a), negate(holds_corner(b, a)));
  const auto along_b = both(negate(along_a), face_leads(b));

  // Point and line features.
  const auto points = both(a.is_point, b.is_point), to_line = both(a.is_point, b.is_line),
             from_line = both(a.is_line, b.is_point);
  const T cosine = dot(a.line, b.line), part = one - cosine * cosine;
  const auto across = [&](const Vec3<T>& line) { return abs(dot(line, normal)) < T(3e-4f); };
  const auto lines =
      both(both(both(a.is_line, b.is_line), part > T(1e-4f)), both(across(a.line), across(b.line)));
  const Vec3<T> apart = a.point - b.point;
  const T on_line_a = dot(a.line, apart), on_line_b = dot(b.line, apart);
  const T whole = select(lines, part, one);
  const T at_a = select(lines, (cosine * on_line_b - on_line_a) / whole, -on_line_a);
  const T at_b = select(lines, (on_line_b - cosine * on_line_a) / whole, on_line_b);
  const Vec3<T> on_a = select(either(from_line, lines), a.point + a.line * at_a, a.point);
  const Vec3<T> on_b = select(either(to_line, lines), b.point + b.line * at_b, b.point);
  const Vec3<T> between = select(lines, cross(a.line, b.line), on_b - on_a);
  const Vec3<T> n = d::unit_along(between, normal);
  const auto features = both(both(known, negate(either(along_a, along_b))),
                             either(either(points, lines), either(to_line, from_line)));
  const auto by_features = both(features, dot(n, normal) > close);

  // Face features.
  const Vec3<T> product = d::unit_along(cross(a.across, b.across), normal);
  const auto by_product = both(both(known, both(a.has_across, b.has_across)),
                               both(both(negate(either(along_a, along_b)), negate(by_features)),
                                    dot(product, normal) > close));
  const auto b_leads = b.cosine > a.cosine + T(d::kFacePreference);
  const auto leads_a = both(by_product, both(negate(b_leads), a.is_on_face)),
             leads_b = both(by_product, both(b_leads, b.is_on_face));
  const Vec3<T> normal_a = select(along_a, a.face * d::side_of(a.face, normal), product);
  const Vec3<T> normal_b = select(along_b, b.face * d::side_of(b.face, normal), product);
  const auto face_a = d::face_contact(a, b, normal_a), face_b = d::face_contact(b, a, normal_b);
  const auto by_a = either(along_a, leads_a), by_b = either(along_b, leads_b);

  const auto rest = d::nearest_or_held(a, b, normal, known);
  const auto choose = [&](const Vec3<T>& with_a, const Vec3<T>& with_b,
                          const Vec3<T>& with_features, const Vec3<T>& other) {
    return select(by_a, with_a, select(by_b, with_b, select(by_features, with_features, other)));
  };
  MovingContact<B, T> c;
  c.a = d::derivative_of(a.point, choose(face_a.of_face, face_b.of_other, on_a, rest.a));
  c.b = d::derivative_of(b.point, choose(face_a.of_other, face_b.of_face, on_b, rest.b));
  c.normal = d::derivative_of(normal, choose(normal_a, normal_b, n, rest.normal));
  c.is_exact = either(either(both(by_a, face_a.is_exact), both(by_b, face_b.is_exact)),
                      either(by_features, rest.is_exact));
  return c;
}

}  // namespace novaphy
