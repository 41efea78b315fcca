// The distance from a point to the surface of a shape, as formulas.
//
// The derivative is exact away from the points where the normal jumps:
//   box              its faces, edges and planes of symmetry
//   sphere, capsule  the center, the axis
//   cylinder, cone   edges, axis and apex
//   ellipsoid        the planes of symmetry within the surface
//
// Freestanding: with T = float the code runs in the forward engine, with T = nova::Real it is
// traced. Both round each operation once, in the same order, and give the same bits.
#pragma once

#include "novaphy/math/types.h"

namespace novaphy {

// The signed distance of a point to a surface (m, < 0 inside), and the outward normal at the
// closest point of the surface. Both are in the shape's frame.
template <class T>
struct SurfaceDistance {
  T distance{};
  Vec3<T> normal{};
};

// Sphere about the origin. Within 1e-8 m of the center the normal is +z.
template <class T>
SurfaceDistance<T> sphere_distance(const Vec3<T>& x, const T& radius) {
  using namespace math;
  const T l = length(x);
  const Vec3<T> up = {T(0.0f), T(0.0f), T(1.0f)};
  return {l - radius, select(l > T(1e-8f), x / l, up)};
}

// Capsule along z. half_height excludes the caps. Within 1e-8 m of the axis the normal is +z, or -z
// at and below the center of the lower cap.
template <class T>
SurfaceDistance<T> capsule_distance(const Vec3<T>& x, const T& radius, const T& half_height) {
  using namespace math;
  const T zero = T(0.0f);
  const auto above = x.z > half_height;
  const auto below = x.z < -half_height;
  const Vec3<T> v = {x.x, x.y,
                     select(above, x.z - half_height, select(below, x.z + half_height, zero))};
  const T l = length(v);
  const Vec3<T> axis = {zero, zero, select(below, T(-1.0f), T(1.0f))};
  return {l - radius, select(l > T(1e-8f), v / l, axis)};
}

// Box with half extents h. Outside, the normal is the direction from the closest point to x.
// Elsewhere the normal is that of the face with the largest q = |x| - h: axis x if qx is the only
// maximum, y if qy is, else z. Its sign is that of the coordinate (+ at 0). On an edge two q are
// exactly 0: qy = qz = 0 gives x, qx = qz = 0 gives y, qx = qy = 0 gives z. A corner gives x. If qx
// = qy is the maximum inside, the normal z does not belong to the distance qx.
template <class T>
SurfaceDistance<T> box_distance(const Vec3<T>& x, const Vec3<T>& h) {
  using namespace math;
  const T zero = T(0.0f);
  const Vec3<T> q = {abs(x.x) - h.x, abs(x.y) - h.y, abs(x.z) - h.z};
  const Vec3<T> e = {max(q.x, zero), max(q.y, zero), max(q.z, zero)};
  const T deepest = max(q.x, max(q.y, q.z));
  // On a face length and min have no gradient. The third argument is the whole derivative there.
  const T distance = with_derivative(length(e) + min(deepest, zero), deepest,
                                     select(deepest == zero, T(1.0f), zero));

  const Vec3<T> closest = {min(max(-h.x, x.x), h.x), min(max(-h.y, x.y), h.y),
                           min(max(-h.z, x.z), h.z)};
  const Vec3<T> outside = normalize(x - closest);
  const auto use_x = either(both(q.x > q.y, q.x > q.z), both(q.y == zero, q.z == zero));
  const auto use_y = either(both(q.y > q.x, q.y > q.z), both(q.x == zero, q.z == zero));
  const Vec3<T> face_x = {sign(x.x), zero, zero};
  const Vec3<T> face_y = {zero, sign(x.y), zero};
  const Vec3<T> face_z = {zero, zero, sign(x.z)};
  const Vec3<T> inside = select(use_x, face_x, select(use_y, face_y, face_z));
  const auto is_outside = either(q.x > zero, either(q.y > zero, q.z > zero));
  return {distance, select(is_outside, outside, inside)};
}

// Plane through the origin with the normal +z. The plane is infinite unless width and length (m,
// along x and y) are both > 0. A finite plane is the top face of a solid block without a lower end.
// (Newton's finite plane has an unsigned distance and always the normal +z. Below and beside the
// plane Newton's contact point is not on the plane. Above, both have the same bits.)
template <class T>
SurfaceDistance<T> plane_distance(const Vec3<T>& x, const T& width, const T& length_y) {
  using namespace math;
  const T zero = T(0.0f), one = T(1.0f), half = T(0.5f);
  const T hx = width * half, hy = length_y * half;
  const T qx = abs(x.x) - hx, qy = abs(x.y) - hy, qz = x.z;
  const auto finite = both(hx > zero, hy > zero);
  const auto beside = both(finite, either(qx > zero, qy > zero));
  const Vec3<T> up = {zero, zero, one};

  // Beside the block: the closest point is on a wall or on the rim.
  const Vec3<T> closest = {min(max(-hx, x.x), hx), min(max(-hy, x.y), hy), min(x.z, zero)};
  const Vec3<T> away = x - closest;
  // Inside of the block a wall may be closer than the top. If both are equally close, the top
  // counts.
  const auto under = both(finite, qz < zero);
  const auto wall_x = both(under, both(qx > qy, qx > qz));
  const auto wall_y = both(under, both(negate(qx > qy), qy > qz));
  const Vec3<T> side_x = {sign(x.x), zero, zero};
  const Vec3<T> side_y = {zero, sign(x.y), zero};

  const T inside = select(wall_x, qx, select(wall_y, qy, qz));
  const Vec3<T> inside_normal = select(wall_x, side_x, select(wall_y, side_y, up));
  return {select(beside, length(away), inside), select(beside, normalize(away), inside_normal)};
}

// Converts a direction (along, up) in the meridian half plane of a solid of revolution about z to a
// direction in space. On the axis the half plane points to +x.
template <class T>
Vec3<T> meridian_direction(const Vec3<T>& x, const T& along, const T& up) {
  using namespace math;
  const T square = x.x * x.x + x.y * x.y;
  const auto off_axis = square > T(0.0f);
  const T l = sqrt(select(off_axis, square, T(1.0f)));
  return {select(off_axis, along * (x.x / l), along), select(off_axis, along * (x.y / l), T(0.0f)),
          up};
}

// Cylinder along z. Inside, the nearer of side and cap counts, or the cap if both are equally near.
// On the axis the direction to the side is +x.
template <class T>
SurfaceDistance<T> cylinder_distance(const Vec3<T>& x, const T& radius, const T& half_height) {
  using namespace math;
  const T zero = T(0.0f), one = T(1.0f);
  const T side = sqrt(x.x * x.x + x.y * x.y) - radius;
  const T cap = abs(x.z) - half_height, up = sign(x.z);
  const auto inside = both(side <= zero, cap <= zero);
  const auto by_side = side > cap;
  const T rho = max(side, zero), z = max(cap, zero);
  const T square = select(inside, one, rho * rho + z * z);
  const T l = sqrt(square);
  const T along = select(inside, select(by_side, one, zero), rho / l);
  const T height = select(inside, select(by_side, zero, up), (z / l) * up);
  return {select(inside, select(by_side, side, cap), l), meridian_direction(x, along, height)};
}

// Cone along z with the base (radius) at -half_height and the apex at +half_height. Inside, the
// nearer of side and base counts, or the base if both are equally near. On the axis the direction
// to the side is +x. At the apex the normal is -x, on the rim -z.
template <class T>
SurfaceDistance<T> cone_distance(const Vec3<T>& x, const T& radius, const T& half_height) {
  using namespace math;
  const T zero = T(0.0f), one = T(1.0f);
  const T rho = sqrt(x.x * x.x + x.y * x.y), height = T(2.0f) * half_height;
  const T slant = sqrt(radius * radius + height * height);
  // Coordinates along and across the generator from the rim to the apex, with the rim as origin.
  const T r = rho - radius, z = x.z + half_height;
  const T across = (r * height + z * radius) / slant;
  const T along = (z * height - r * radius) / slant;
  const Vec3<T> down = {zero, zero, T(-1.0f)};
  const SurfaceDistance<T> side = {across, meridian_direction(x, height / slant, radius / slant)};
  const SurfaceDistance<T> base = {-z, down};
  // Outside: the distance to the apex as a point, and the distance to the rim or the base.
  const Vec3<T> d = {x.x, x.y, x.z - half_height};
  const T square = (d.x * d.x + d.y * d.y) + d.z * d.z;
  const auto off_apex = square > zero;
  const T l = sqrt(select(off_apex, square, one));
  const T away = select(off_apex, l, zero);
  const Vec3<T> out = {select(off_apex, d.x / l, T(-1.0f)), select(off_apex, d.y / l, zero),
                       select(off_apex, d.z / l, zero)};
  const T over = max(r, zero), rim_square = over * over + z * z;
  const auto off_rim = rim_square > zero;
  const T rim = sqrt(select(off_rim, rim_square, one));
  const SurfaceDistance<T> below = {
      select(off_rim, rim, zero),
      select(off_rim, meridian_direction(x, over / rim, z / rim), down)};
  const auto inside = both(across <= zero, z >= zero);
  const auto by_side =
      either(both(inside, across > -z),
             both(negate(inside), both(both(along >= zero, along <= slant), across > zero)));
  const auto by_apex = along > slant;
  return {select(by_side, side.distance,
                 select(inside, base.distance, select(by_apex, away, below.distance))),
          select(by_side, side.normal,
                 select(inside, base.normal, select(by_apex, out, below.normal)))};
}

// Ellipsoid with half axes h. The nearest point is y_i = h_i^2 x_i / (t + h_i^2), where t solves
// sum (h_i x_i / (t + h_i^2))^2 = 1. Newton's method runs on the square root of the sum, from below
// (J. J. More, D. C. Sorensen, Computing a Trust Region Step, 1983). Coordinates |x_i| below 1e-6
// h_i are raised to this value, which selects one nearest point on the planes of symmetry. There
// the derivative is that of the smooth function, or 0 in a coordinate in which the nearest point
// jumps.
template <class T>
SurfaceDistance<T> ellipsoid_distance(const Vec3<T>& x, const Vec3<T>& h) {
  using namespace math;
  constexpr int kIterations = 8;
  const T one = T(1.0f), shortest = min(h.x, min(h.y, h.z));
  const T xs[3] = {x.x, x.y, x.z}, hs[3] = {h.x, h.y, h.z};
  T at[3], excess[3], u[3];  // |x_i|, h_i^2 - shortest^2, h_i |x_i|
  for (int i = 0; i < 3; ++i) {
    at[i] = max(abs(xs[i]), T(1e-6f) * hs[i]);
    excess[i] = (hs[i] - shortest) * (hs[i] + shortest);
    u[i] = hs[i] * at[i];
  }
  // Returns s after a Newton step. s = t + shortest^2 avoids the cancellation in t.
  const auto improve = [&](const T& s, const T(&v)[3]) {
    T sum = T(0.0f), slope = T(0.0f);
    for (int i = 0; i < 3; ++i) {
      const T inverse = one / (s + excess[i]), p = v[i] * inverse, square = p * p;
      sum = sum + square;
      slope = slope + square * inverse;
    }
    return s + (sum / slope) * (sqrt(sum) - one);
  };
  T fixed[3];
  for (int i = 0; i < 3; ++i) fixed[i] = detach(u[i]);
  T s = max(fixed[0] - detach(excess[0]),
            max(fixed[1] - detach(excess[1]), fixed[2] - detach(excess[2])));
  for (int k = 0; k < kIterations; ++k) s = detach(improve(s, fixed));
  // The distance is smooth in a raised coordinate unless t + h_i^2 vanishes.
  for (int i = 0; i < 3; ++i) {
    const auto limited = abs(xs[i]) < T(1e-6f) * hs[i];
    const auto smooth = s + detach(excess[i]) > T(1e-3f) * (hs[i] * hs[i]);
    const T side = select(xs[i] < T(0.0f), -one, one);
    at[i] = with_derivative(at[i], xs[i], select(both(limited, smooth), side, T(0.0f)));
    u[i] = hs[i] * at[i];
  }
  s = improve(s, u);  // a last Newton step, whose derivative is that of the root
  T y[3], n[3];
  for (int i = 0; i < 3; ++i) {
    const T share = u[i] / (s + excess[i]);  // y_i / h_i
    const T side = select(xs[i] < T(0.0f), -one, one);
    y[i] = side * (hs[i] * share);
    n[i] = side * (share / hs[i]);
  }
  const Vec3<T> normal = normalize(Vec3<T>{n[0], n[1], n[2]});
  return {dot(normal, x - Vec3<T>{y[0], y[1], y[2]}), normal};
}

// The type of a static shape as flags: bool, or nova::Bool in a trace. A plane has no flag set.
template <class B>
struct StaticShapeType {
  B is_box{}, is_sphere{}, is_capsule{}, is_cylinder{}, is_cone{}, is_ellipsoid{};
};
// is(type): whether the shape has this type. Type is GeoType as a template argument, because files
// of formulas do not include its header.
template <class Type, class B, class Is>
StaticShapeType<B> static_shape_type(const Is& is) {
  return {is(Type::BOX),      is(Type::SPHERE), is(Type::CAPSULE),
          is(Type::CYLINDER), is(Type::CONE),   is(Type::ELLIPSOID)};
}

// Returns signed distance and normal in the frame of a shape of any supported type. GeoType
// describes `scale`. `Round` includes cylinders, cones and ellipsoids.
template <bool Round, class B, class T>
SurfaceDistance<T> static_shape_distance(const StaticShapeType<B>& type, const Vec3<T>& scale,
                                         const Vec3<T>& x) {
  using namespace math;
  const SurfaceDistance<T> box = box_distance(x, scale);
  const SurfaceDistance<T> sphere = sphere_distance(x, scale.x);
  const SurfaceDistance<T> capsule = capsule_distance(x, scale.x, scale.y);
  const SurfaceDistance<T> plane = plane_distance(x, scale.x, scale.y);
  const SurfaceDistance<T> flat = {
      select(type.is_box, box.distance,
             select(type.is_sphere, sphere.distance,
                    select(type.is_capsule, capsule.distance, plane.distance))),
      select(type.is_box, box.normal,
             select(type.is_sphere, sphere.normal,
                    select(type.is_capsule, capsule.normal, plane.normal)))};
  if constexpr (!Round) {
    return flat;
  } else {
    // For other types the sizes are 1, which avoids a division by 0. The gradient of the unused
    // branch is multiplied by 0, and must therefore be finite.
    const T one = T(1.0f);
    const auto solid = either(type.is_cylinder, type.is_cone);
    const T radius = select(solid, scale.x, one), height = select(solid, scale.y, one);
    const SurfaceDistance<T> cylinder = cylinder_distance(x, radius, height);
    const SurfaceDistance<T> cone = cone_distance(x, radius, height);
    const SurfaceDistance<T> ellipsoid =
        ellipsoid_distance(x, select(type.is_ellipsoid, scale, Vec3<T>{one, one, one}));
    return {select(type.is_cylinder, cylinder.distance,
                   select(type.is_cone, cone.distance,
                          select(type.is_ellipsoid, ellipsoid.distance, flat.distance))),
            select(type.is_cylinder, cylinder.normal,
                   select(type.is_cone, cone.normal,
                          select(type.is_ellipsoid, ellipsoid.normal, flat.normal)))};
  }
}

}  // namespace novaphy
