// Capsule against capsule and against box, in closed form. Two contacts exist if the capsule lies
// along the other capsule or along a face (clip_manifold.h). Frame of A, m.
//
// Capsules: the contact is at the nearest points of the two segments. Crossing segments separate
// along the normal of their plane, and overlapping collinear segments perpendicular to their line.
// The signed distance then is minus the sum of the radii.
//
// Box: the point of an outside segment that is nearest to the box is one of its ends, or lies on
// one of the 12 edges. A segment that intersects the box separates along the shortest of six
// directions: 3 face normals and 3 cross products of the segment and an edge. If two are equally
// short, the first is chosen. MuJoCo 4.0 gives wrong results for the intersecting case.
#pragma once

#include "novaphy/collision/geometry/clip_manifold.h"
#include "novaphy/collision/geometry/segment.h"
#include "novaphy/collision/geometry/sphere_pairs.h"

namespace novaphy::geometry {

inline constexpr float kAxisSine = 1e-4f;      // edges closer to parallel give no cross axis
inline constexpr float kTouchingCore = 2e-6f;  // of the size: nearer points give no direction

// Computes the proximity of the surfaces from the nearest points of two cores. Returns false if the
// points are too near to define a direction.
inline bool proximity_of_points(const Vec3f& a, const Vec3f& b, float ra, float rb, float size,
                                Proximity& out) {
  const Vec3f d = b - a;
  const float l = math::length(d);
  if (!(l > kTouchingCore * size)) return false;
  const Vec3f n = d / l;
  out = {n, (l - ra) - rb, a + n * ra, b - n * rb};
  return true;
}

NOVAPHY_OUT_OF_LINE Manifold collide_capsules(const ShapePair& pair, float gap) {
  const float ra = pair.a->scale.x, rb = pair.b->scale.x;
  const Vec3f u = {0.0f, 0.0f, pair.a->scale.y};
  const Vec3f v = math::column(pair.rotation, 2) * pair.b->scale.y;
  const SegmentPoints p = nearest_of_segments(-u, u, pair.offset - v, pair.offset + v);
  Proximity proximity;
  if (!proximity_of_points(p.a, p.b, ra, rb, ra + rb, proximity)) {
    Vec3f n = math::cross(u, v);
    const float sine = math::length(n);
    const bool crossing = sine > kAxisSine * (pair.a->scale.y * pair.b->scale.y);
    n = crossing ? n / sine : any_orthogonal(pair.a->scale.y > 0.0f ? u : v);
    if (n == Vec3f{}) n = {1.0f, 0.0f, 0.0f};
    if (math::dot(n, pair.offset) < 0.0f) n = -n;
    const float distance = (math::dot(p.b - p.a, n) - ra) - rb;
    proximity = {n, distance, p.a + n * ra, p.b - n * rb};
  }
  return clip_manifold(pair, proximity, gap);
}

// Returns the shortest translation that moves the segment c - u .. c + u out of the box. The
// segment intersects the box. Frame of the box. The normal points out of the box, and the distance
// is that of the segment, < 0.
inline SolidPoint segment_out_of_box(const Vec3f& c, const Vec3f& u, const Vec3f& h) {
  SolidPoint best;
  bool found = false;
  auto ask = [&](Vec3f n) {
    const float side = math::dot(n, c);
    if (side < 0.0f) n = -n;
    const Vec3f m = {math::abs(n.x), math::abs(n.y), math::abs(n.z)};
    const float distance = (math::abs(side) - math::abs(math::dot(n, u))) - math::dot(m, h);
    if (found && !(distance > best.distance)) return;
    found = true;
    best = {distance, n};
  };
  for (int32_t i = 0; i < 3; ++i) ask(unit_axis(i, 1.0f));
  for (int32_t i = 0; i < 3; ++i) {
    const Vec3f n = math::cross(unit_axis(i, 1.0f), u);
    const float sine = math::length(n);
    if (sine > kAxisSine * math::length(u)) ask(n / sine);
  }
  return best;
}

// Finds the nearest points of the box and a segment outside of it, in the frame of the box.
inline void nearest_of_segment_and_box(const Vec3f& s0, const Vec3f& s1, const Vec3f& h,
                                       Vec3f& on_segment, Vec3f& on_box) {
  float best = -1.0f;
  auto ask = [&](const Vec3f& s, const Vec3f& b) {
    const Vec3f d = s - b;
    const float square = math::dot(d, d);
    if (best >= 0.0f && !(square < best)) return;
    best = square;
    on_segment = s;
    on_box = b;
  };
  for (int32_t end = 0; end < 2; ++end) {
    const Vec3f x = end == 0 ? s0 : s1;
    ask(x, {math::clamp(x.x, -h.x, h.x), math::clamp(x.y, -h.y, h.y), math::clamp(x.z, -h.z, h.z)});
  }
  for (int32_t edge = 0; edge < 12; ++edge) {
    const int32_t axis = edge / 4, u = (axis + 1) % 3, v = (axis + 2) % 3;
    const Vec3f middle = unit_axis(u, edge % 2 == 0 ? component(h, u) : -component(h, u)) +
                         unit_axis(v, edge % 4 < 2 ? component(h, v) : -component(h, v));
    const Vec3f half = unit_axis(axis, component(h, axis));
    const SegmentPoints p = nearest_of_segments(s0, s1, middle - half, middle + half);
    ask(p.a, p.b);
  }
}

// Returns whether the segment intersects the box (slab test).
inline bool segment_meets_box(const Vec3f& s0, const Vec3f& s1, const Vec3f& h) {
  float enter = 0.0f, leave = 1.0f;
  for (int32_t i = 0; i < 3; ++i) {
    const float a = component(s0, i), d = component(s1, i) - a, e = component(h, i);
    if (d == 0.0f) {
      if (math::abs(a) > e) return false;
      continue;
    }
    const float t0 = (-e - a) / d, t1 = (e - a) / d;
    enter = math::max(enter, math::min(t0, t1));
    leave = math::min(leave, math::max(t0, t1));
  }
  return enter <= leave;
}

// Returns the contacts of a capsule A and a box B.
NOVAPHY_OUT_OF_LINE Manifold collide_capsule_box(const ShapePair& pair, float gap) {
  const Vec3f h = pair.b->scale;
  const float r = pair.a->scale.x;
  const Vec3f c = apply_transposed(pair.rotation, -pair.offset);
  const Vec3f u = apply_transposed(pair.rotation, {0.0f, 0.0f, pair.a->scale.y});
  Vec3f on_segment{}, on_box{};
  Proximity local;  // frame of the box, from capsule to box
  bool apart = !segment_meets_box(c - u, c + u, h);
  if (apart) {
    nearest_of_segment_and_box(c - u, c + u, h, on_segment, on_box);
    const float size = r + math::length(h);
    apart = proximity_of_points(on_segment, on_box, r, 0.0f, size, local);
  }
  if (!apart) {
    const SolidPoint way = segment_out_of_box(c, u, h);
    const Vec3f end = math::dot(way.normal, u) > 0.0f ? c - u : c + u;  // deeper end of the segment
    local = {-way.normal, way.distance - r, end - way.normal * r, end - way.normal * way.distance};
  }
  const Proximity proximity = {apply(pair.rotation, local.normal), local.distance,
                               from_b(pair, local.on_a), from_b(pair, local.on_b)};
  return clip_manifold(pair, proximity, gap);
}

}  // namespace novaphy::geometry
