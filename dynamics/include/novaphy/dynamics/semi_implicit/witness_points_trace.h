// Nearest points of curved shapes: the derivative of the points and the normal of a contact by the
// poses of its bodies. At least one shape is a cylinder, a cone, an ellipsoid, a hull or a mesh.
//
// Law. The nearest points of the cores of A and B are a and b. The normal n points from A to B, and
// d is the gap between the cores. The symbols p and m stand for a and n fixed in A, and q and k for
// b and n fixed in B. The matrix C of a side is the inverse of its shape operator in the tangent
// plane (m). C gives the displacement of the side's nearest point per rotation of the normal.
//     (C_A + C_B + d) dn = (dq - dp) + C_A dm + C_B dk
//     da = dp + C_A (dn - dm),   db = dq - C_B (dn - dk),   db - da = d dn + n dd
// C is 0 at a vertex. C is infinite along a straight line of a side and in a face. The normal turns
// with the body there, and the third equation moves the point. The features have this C:
//     sphere, end of a capsule, corner, apex of a cone     C = 0
//     capsule, edge                      infinite along the line, 0 across
//     face, base                         infinite
//     side of a cylinder or a cone       infinite along its line, rho / (n . e) around the axis
//     rim                                rho / (n . e) along the rim, 0 across
//     ellipsoid, half axes D             (D^2 - a a^T) / |D n|, a from the center
//
// rho is the distance of the point from the axis, and e the direction from the axis to the point.
// In the code "infinite" is a large number, in a basis of the tangent plane along the line.
//
// A normal along a face at one of its edges or corners comes from that face, which "leads". The
// inside of a face on the other side leads in its place. Only hulls and meshes, and what touches
// them, have such normals.
//
// The search clips an edge of the other side by a face almost along the normal, with planes through
// the edges of this face. Where such an edge meets the face's edge, the point of the other side
// stays on both its line and that plane:
//     g . (db + s v - (dp + d dm)) = 0,   db + s v   instead of   db
// g is the normal of the plane, and v the direction of the other line. The point on the face is
// then beside the edge, else on it: by the gap times the sine between face and normal.
//
// The points and the normal are those of the search. Their relative error is that of the derivative
// too. Points that are not the nearest ones are not exact.
//
// Freestanding: T = float tests which contacts are exact, T = nova::Real is traced.
#pragma once

#include "novaphy/math/types.h"

namespace novaphy {

// The search's error of a normal (rad), and of a point (relative to the size of its shape).
inline constexpr float kWitnessNoise = 4e-3f;
// The same error of a normal between shapes without curvature (rad).
inline constexpr float kFlatNoise = 3e-4f;
// Equal to kFaceCosine and kFacePreference of clip_manifold.h.
inline constexpr float kClipCosine = 0.99863f, kClipPreference = 1e-4f;

// One side of a contact. Only `point` and `normal` have derivatives.
template <class B, class T>
struct WitnessSide {
  B is_known{}, is_curved{}, is_polytope{};
  B leads{};                  // an edge or a corner with the normal of one of its faces
  B is_sure{};                // an edge across the normal, or a face along it, within kFlatNoise
  // An edge of a face that clips the other side: the normal of the plane through that edge, and the
  // cosine between the face and the contact normal.
  B clips{};
  Vec3<T> cut{};
  T cosine{}, aside{};  // aside: as in PolytopeFeature
  T rounding{};         // error of the point (m)
  Vec3<T> point{}, normal{};  // fixed in the body
  B is_line{}, is_face{};     // C is infinite along `line`, or everywhere
  Vec3<T> line{};
  // The finite part of C: turn (diag(squares) - a a^T) turn^-1 / length + around t t^T, with a in
  // `deepest` and t in `tangent`.
  Quat<T> turn{};
  Vec3<T> squares{}, deepest{}, tangent{};
  T length{}, around{}, size{};
};

namespace witness_detail {

// A symmetric matrix of the tangent plane.
template <class T>
struct Plane2 {
  T xx{}, xy{}, yy{};
};
template <class T>
Vec2<T> times(const Plane2<T>& m, const Vec2<T>& v) {
  return {m.xx * v.x + m.xy * v.y, m.xy * v.x + m.yy * v.y};
}
template <class T>
Vec2<T> difference(const Vec2<T>& a, const Vec2<T>& b) {
  return {a.x - b.x, a.y - b.y};
}
template <class T>
Vec3<T> still(const Vec3<T>& v) {
  using namespace math;
  return {detach(v.x), detach(v.y), detach(v.z)};
}

// A basis of the tangent plane, without derivatives.
template <class T>
struct Tangents {
  Vec3<T> x{}, y{};
  Vec2<T> of(const Vec3<T>& v) const { return {math::dot(x, v), math::dot(y, v)}; }
  Vec3<T> world(const Vec2<T>& v) const { return x * v.x + y * v.y; }
};

// Returns a basis whose first axis lies along a vector. n: the normal.
template <class T>
Tangents<T> tangents_along(const Vec3<T>& along, const Vec3<T>& n) {
  using namespace math;
  Tangents<T> t;
  t.x = along - n * dot(n, along);
  const T square = dot(t.x, t.x);
  t.x = t.x / sqrt(select(square > T(1e-6f), square, T(1.0f)));
  t.y = cross(n, t.x);
  return t;
}

template <class B, class T>
Plane2<T> finite(const WitnessSide<B, T>& s, const Tangents<T>& t) {
  using namespace math;
  const Vec3<T> x = rotate_inverse(s.turn, t.x), y = rotate_inverse(s.turn, t.y);
  const auto product = [&](const Vec3<T>& v, const Vec3<T>& w) {
    const T squares = (s.squares.x * v.x * w.x + s.squares.y * v.y * w.y) + s.squares.z * v.z * w.z;
    return (squares - dot(s.deepest, v) * dot(s.deepest, w)) / s.length +
           s.around * dot(s.tangent, v) * dot(s.tangent, w);
  };
  return {product(x, x), product(x, y), product(y, y)};
}

// Returns the whole C of a side: c, its finite part, plus a large number where C is infinite.
template <class B, class T>
Plane2<T> whole(const WitnessSide<B, T>& s, const Tangents<T>& t, const Plane2<T>& c,
                const T& large) {
  using namespace math;
  const T zero = T(0.0f), line = select(s.is_line, large, zero),
          face = select(s.is_face, large, zero);
  const Vec2<T> l = t.of(s.line);
  return {c.xx + line * l.x * l.x + face, c.xy + line * l.x * l.y, c.yy + line * l.y * l.y + face};
}

// Returns `point`, moved along `line` onto the plane of a side that clips it. The plane moves with
// `on_side`.
template <class B, class T>
Vec3<T> onto_cut(const Vec3<T>& point, const Vec3<T>& line, const WitnessSide<B, T>& side,
                 const Vec3<T>& on_side) {
  using namespace math;
  const T into = dot(side.cut, line);
  const auto cuts = abs(into) > T(1e-3f);
  return point - line * (dot(side.cut, point - on_side) / select(cuts, into, T(1.0f)));
}

// Returns the motion of the point of A along its line, from the remaining equation of two lines.
// `of_b`: the line of B in the tangent plane, where the line of A is the first axis.
template <class B, class T>
T slide_of(const B& crossing, const Vec2<T>& left, const Vec2<T>& of_b) {
  using namespace math;
  const auto crosses = both(crossing, abs(of_b.y) > T(1e-2f));
  const T slide = left.x - left.y * of_b.x / select(crosses, of_b.y, T(1.0f));
  return select(crossing, slide, T(0.0f));
}

// Which of two crossing edges is that of a face that clips the other edge. Unclear: the point on the
// face does not show whether it is on the edge.
template <class B>
struct Clipped {
  B by_a{}, by_b{}, is_unclear{};
};
template <class B, class T>
Clipped<B> clipped_by(const WitnessSide<B, T>& a, const WitnessSide<B, T>& b, const B& crossing,
                      const T& gap) {
  using namespace math;
  const auto by_a = both(both(crossing, a.clips),
                         negate(both(b.clips, b.cosine > a.cosine + T(kClipPreference)))),
             by_b = both(both(crossing, b.clips), negate(by_a));
  const auto aside = [&](const WitnessSide<B, T>& s) {
    return gap * sqrt(max(T(1.0f) - s.cosine * s.cosine, T(1e-12f)));
  };
  const T by = select(by_a, aside(a), aside(b)), half = by * T(0.5f);
  return {both(by_a, a.aside > half), both(by_b, b.aside > half),
          both(either(by_a, by_b), by < a.rounding + b.rounding)};
}

}  // namespace witness_detail

// Sets a side whose shape has an axis of revolution: a cylinder or a cone. In the shape's frame:
// `x`: the point, `out`: the normal that points out of the shape, `half`: radius and half height
// (m).
template <class B, class T>
void set_revolution(WitnessSide<B, T>& s, const B& is_cone, const Vec3<T>& x, const Vec3<T>& out,
                    const Vec3<T>& half) {
  using namespace math;
  const T zero = T(0.0f), one = T(1.0f), on = s.size * T(1e-4f), near = T(kWitnessNoise);
  const T rho = sqrt(x.x * x.x + x.y * x.y);
  const auto at_axis = rho <= on;
  const T whole = select(at_axis, one, rho);
  const Vec3<T> e = {x.x / whole, x.y / whole, zero};
  s.tangent = {-e.y, e.x, zero};
  const auto at_end = either(x.z <= on - half.y, both(negate(is_cone), x.z >= half.y - on));
  const auto apex = both(is_cone, both(at_axis, x.z >= half.y - on));
  const auto base = both(at_end, abs(out.z) >= T(1.0f - 1e-6f));
  const auto rim = both(both(at_end, negate(base)), rho >= half.x - on);
  const auto side = negate(either(at_end, either(at_axis, apex)));
  // The straight line of the lateral surface goes through the apex, or along the axis.
  const Vec3<T> to_apex = {x.x, x.y, x.z - half.y};
  const T long_as = sqrt(select(at_axis, one, dot(to_apex, to_apex)));
  const Vec3<T> line = select(is_cone, to_apex / long_as, Vec3<T>{zero, zero, one});
  const T outward = dot(out, e), tilt = abs(dot(out, line));
  const auto is_round = both(outward > near, abs(dot(out, s.tangent)) < near);
  const auto on_side = both(both(side, is_round), tilt < near);
  const auto on_rim = both(both(rim, is_round), tilt > near);
  const auto is_curve = either(on_side, on_rim);
  s.around = select(is_curve, rho / select(is_curve, outward, one), zero);
  s.is_line = on_side;
  s.is_face = base;
  s.line = line;
  s.is_known = either(either(apex, base), is_curve);
}

// Sets a side that is an edge or a corner whose face leads, or a feature of a hull or a mesh.
template <template <class, class> class Shape, template <class, class> class Feature, class B,
          class T>
void set_polytope(WitnessSide<B, T>& s, const Shape<B, T>& shape, const Vec3<T>& normal,
                  const Feature<B, T>& feature) {
  using namespace math;
  const auto& of = shape.polytope;
  const Vec3<T> line = witness_detail::still(rotate(s.turn, of.line));
  const auto across = [&](const Vec3<T>& v, float noise) { return abs(dot(v, normal)) < T(noise); };
  const auto edge = both(of.is_edge, across(line, kWitnessNoise));
  const auto box_leads =
      both(both(shape.is_box, feature.is_along),
           either(feature.is_point, both(feature.is_line, across(feature.line, kWitnessNoise))));
  const auto clips = both(edge, dot(of.clips, of.clips) > T(0.5f)),
             box_clips = both(both(s.is_line, shape.is_box), feature.cosine > T(kClipCosine));
  const Vec3<T> face = witness_detail::still(select(clips, rotate(s.turn, of.clips), feature.face));
  s.clips = either(clips, box_clips);
  s.aside = detach(select(clips, of.aside, s.aside));
  s.is_polytope = shape.is_polytope;
  s.leads = either(of.leads, box_leads);
  s.is_known = either(s.is_known, either(of.is_face, either(of.is_corner, edge)));
  s.is_face = either(s.is_face, of.is_face);
  s.is_line = either(s.is_line, either(edge, both(box_leads, feature.is_line)));
  s.line = select(edge, line, s.line);
  s.cut = cross(s.line, face);
  s.cosine = detach(abs(dot(face, normal)));
  s.is_sure = either(negate(either(of.is_face, s.is_line)),
                     either(both(of.is_face, of.is_along), across(s.line, kFlatNoise)));
}

// Returns a side of a contact with a hull or a mesh. The side is its leading face unless the other
// side is the inside of a face.
template <class B, class T>
WitnessSide<B, T> leading_side(const WitnessSide<B, T>& side, const WitnessSide<B, T>& other) {
  using namespace math;
  const auto beside = both(side.leads, either(side.is_polytope, other.is_polytope));
  const auto face = both(beside, negate(other.is_face));
  WitnessSide<B, T> s = side;
  s.is_known = either(side.is_known, beside);
  s.is_face = either(side.is_face, face);
  s.is_line = both(side.is_line, negate(face));
  return s;
}

// Returns the side of a shape at a contact point. `shape`: as for contact_feature_of. `feature`:
// the shape's feature there, used for the side of the normal and for shapes that are not curved.
template <template <class, class> class Shape, template <class, class> class Feature, class B,
          class T>
WitnessSide<B, T> witness_side(const Shape<B, T>& shape, const Transform<T>& body,
                               const Vec3<T>& body_point, const Vec3<T>& normal,
                               const Feature<B, T>& feature) {
  using namespace math;
  const T zero = T(0.0f), one = T(1.0f);
  const Quat<T> body_turn = {detach(body.q.x), detach(body.q.y), detach(body.q.z),
                             detach(body.q.w)};
  WitnessSide<B, T> s;
  s.point = transform_point(body, body_point);
  s.normal = rotate(body.q, rotate_inverse(body_turn, witness_detail::still(normal)));
  s.turn = multiply(body_turn, shape.pose.q);
  const Vec3<T> h = shape.scale, x = transform_point(inverse(shape.pose), body_point);
  const Vec3<T> n = rotate_inverse(s.turn, witness_detail::still(normal));
  const Vec3<T> out = n * feature.direction;
  const auto revolves = either(shape.is_cylinder, shape.is_cone);
  s.is_curved = either(revolves, shape.is_ellipsoid);
  s.size = max(h.x, max(h.y, h.z));
  set_revolution(s, shape.is_cone, x, out, h);
  // Shapes without curvature.
  const auto flat = both(feature.is_flat, feature.is_along);
  const auto corner = both(feature.is_point, negate(feature.is_along)),
             edge = both(both(feature.is_line, negate(feature.is_along)),
                         abs(dot(feature.line, normal)) < T(kWitnessNoise));
  const auto plain = both(feature.is_known, either(flat, either(corner, edge)));
  const Vec3<T> line = rotate(s.turn, s.line);
  s.line = witness_detail::still(select(revolves, line, feature.line));
  s.is_line = select(revolves, s.is_line, edge);
  s.is_face = select(revolves, s.is_face, flat);
  s.around = select(revolves, s.around, zero);
  // Ellipsoids.
  const Vec3<T> d = {h.x * out.x, h.y * out.y, h.z * out.z};
  const T long_as = sqrt(dot(d, d));
  s.length = select(shape.is_ellipsoid, long_as, one);
  const T part = select(shape.is_ellipsoid, one, zero);
  s.squares = Vec3<T>{h.x * h.x, h.y * h.y, h.z * h.z} * part;
  s.deepest = Vec3<T>{h.x * d.x, h.y * d.y, h.z * d.z} * (part / s.length);
  const Vec3<T> off = s.deepest - x;
  const auto nearest =
      both(shape.is_ellipsoid, dot(off, off) < s.size * s.size * T(kWitnessNoise * kWitnessNoise));
  s.is_known = select(revolves, s.is_known, select(shape.is_ellipsoid, nearest, plain));
  // The distance of a point of a box from the side that neither holds the edge's line nor is the
  // face closest to the normal.
  const Vec3<T> l = rotate_inverse(s.turn, feature.line), f = rotate_inverse(s.turn, feature.face);
  s.aside = abs(((abs(x.x) - h.x) * (one - l.x * l.x - f.x * f.x) +
                 (abs(x.y) - h.y) * (one - l.y * l.y - f.y * f.y)) +
                (abs(x.z) - h.z) * (one - l.z * l.z - f.z * f.z));
  s.rounding = T(1e-6f) * sqrt(dot(x, x) + T(1e-30f));
  set_polytope(s, shape, normal, feature);
  return s;
}

template <class B, class T>
struct WitnessPoints {
  Vec3<T> a{}, b{}, normal{};  // use their derivatives only, not their values
  B is_exact{};
};

template <class B, class T>
WitnessPoints<B, T> witness_points(const WitnessSide<B, T>& side_a, const WitnessSide<B, T>& side_b,
                                   const Vec3<T>& contact_normal) {
  using namespace math;
  using namespace witness_detail;
  const WitnessSide<B, T> a = leading_side(side_a, side_b), b = leading_side(side_b, side_a);
  const T zero = T(0.0f), one = T(1.0f);
  const Vec3<T> n = still(contact_normal), apart = b.point - a.point;
  const T d = detach(dot(n, apart));
  // The basis lies along the line of A; without such a line, along that of B.
  const Vec3<T> any =
      select(abs(n.x) < T(0.6f), Vec3<T>{one, zero, zero}, Vec3<T>{zero, one, zero});
  const Vec3<T> along = select(a.is_line, a.line, select(b.is_line, b.line, cross(n, any)));
  const Tangents<T> t = tangents_along(along, n);
  const T size = a.size + b.size, large = (size + abs(d)) * T(1e6f);
  const Plane2<T> own_a = finite(a, t), own_b = finite(b, t), all_a = whole(a, t, own_a, large),
                  all_b = whole(b, t, own_b, large);
  const T xx = (all_a.xx + all_b.xx) + d, xy = all_a.xy + all_b.xy, yy = (all_a.yy + all_b.yy) + d,
          det = xx * yy - xy * xy;
  const auto regular = both(both(xx > zero, yy > zero), det > xx * yy * T(1e-3f));
  const T by = one / select(regular, det, one);
  const Vec2<T> p = t.of(apart), m = t.of(a.normal), k = t.of(b.normal);
  const Vec2<T> from_a = times(all_a, m), from_b = times(all_b, k);
  const Vec2<T> r = {p.x + (from_a.x + from_b.x), p.y + (from_a.y + from_b.y)};
  const Vec2<T> turn = {(yy * r.x - xy * r.y) * by, (xx * r.y - xy * r.x) * by};
  const Vec2<T> move_a = times(own_a, difference(turn, m)),
                move_b = times(own_b, difference(k, turn));
  const Vec2<T> left = {(p.x + move_b.x) - (move_a.x + d * turn.x),
                        (p.y + move_b.y) - (move_a.y + d * turn.y)};
  const Vec2<T> of_b = t.of(b.line);
  const auto crossing = both(a.is_line, b.is_line);
  const T slide = slide_of(crossing, left, of_b);
  const Vec3<T> at_a = a.point + t.world({move_a.x + slide, move_a.y}),
                at_b = b.point + t.world(move_b);
  const Clipped<B> clipped = clipped_by(a, b, crossing, abs(d));
  const Vec3<T> cut_b = onto_cut(at_b, b.line, a, a.point + a.normal * d),
                cut_a = onto_cut(a.point + t.world(move_a), a.line, b, b.point - b.normal * d);
  WitnessPoints<B, T> w;
  w.normal = t.world(turn);
  const Vec3<T> across = w.normal * d + n * dot(n, apart);
  const auto free_a = either(a.is_line, a.is_face), free_b = either(b.is_line, b.is_face);
  const auto by_b = either(both(free_a, negate(free_b)), clipped.by_a);
  const Vec3<T> leads_a = select(clipped.by_b, cut_a, at_a),
                leads_b = select(clipped.by_a, cut_b, at_b);
  w.a = select(by_b, leads_b - across, leads_a);
  w.b = select(by_b, leads_b, leads_a + across);
  const auto parallel = both(crossing, abs(of_b.y) <= T(1e-2f));
  const auto flat = either(both(a.is_face, free_b), both(b.is_face, free_a));
  const T aside = detach(p.x * p.x + p.y * p.y);
  const auto curved = either(a.is_curved, b.is_curved);
  const auto sure = both(either(curved, both(a.is_sure, b.is_sure)), negate(clipped.is_unclear));
  w.is_exact =
      both(both(both(both(a.is_known, b.is_known), sure),
                either(curved, either(a.is_polytope, b.is_polytope))),
           both(both(regular, negate(either(parallel, flat))), aside < size * size * T(1e-6f)));
  return w;
}

}  // namespace novaphy
