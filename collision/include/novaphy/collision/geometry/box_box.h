// Box against box: 15 separating axes, then clipping of the faces (clip_manifold.h). Frame of A, m.
//
// The axis with the largest separation is chosen. A cross axis of two edges must exceed the face
// axes by kEdgeBias times the size of the boxes. Rounding then does not turn a face contact into an
// edge contact. Normal and depth of overlapping boxes are exact up to this bias. For separate
// boxes, the separation of a face axis is the distance only if the clipped faces overlap. Otherwise
// GJK computes the distance. Source of the axes: Gottschalk, Lin, Manocha, OBBTree (1996).
#pragma once

#include "novaphy/collision/geometry/convex_pair.h"
#include "novaphy/collision/geometry/segment.h"

namespace novaphy::geometry {

inline constexpr float kEdgeBias = 2e-6f;      // of the sum of the half extents
inline constexpr float kEdgeAxisSine = 1e-4f;  // edges closer to parallel give no cross axis

struct BoxAxis {
  Vec3f normal{};  // from A to B
  float separation{};
  int32_t edge_a = -1, edge_b = -1;  // directions of the edges of a cross axis
};

// Returns the separation along the unit axis n, flipped to point from A to B.
inline BoxAxis box_axis(const ShapePair& pair, const Vec3f& n) {
  const Vec3f m = apply_transposed(pair.rotation, n);
  const float side = math::dot(n, pair.offset);
  const Vec3f a = {math::abs(n.x), math::abs(n.y), math::abs(n.z)};
  const Vec3f b = {math::abs(m.x), math::abs(m.y), math::abs(m.z)};
  return {side < 0.0f ? -n : n,
          (math::abs(side) - math::dot(a, pair.a->scale)) - math::dot(b, pair.b->scale)};
}

// Returns whether a face axis of one box is also an axis of the other box, within half of
// kEdgeBias. Every cross axis then is nearly a face axis, and cannot exceed the face axes by
// kEdgeBias.
inline bool share_an_axis(const ShapePair& pair) {
  constexpr float kNone = 0.5f * kEdgeBias;
  for (int32_t i = 0; i < 3; ++i) {
    const Vec3f c = math::column(pair.rotation, i);
    const int32_t none = (math::abs(c.x) <= kNone ? 1 : 0) + (math::abs(c.y) <= kNone ? 1 : 0) +
                         (math::abs(c.z) <= kNone ? 1 : 0);
    if (none == 2) return true;
  }
  return false;
}

// Returns the axis with the largest separation. If the boxes are farther apart than the gap, the
// function returns any axis whose separation exceeds the gap.
inline BoxAxis best_box_axis(const ShapePair& pair, float gap) {
  BoxAxis best = box_axis(pair, unit_axis(0, 1.0f));
  for (int32_t i = 1; i < 6; ++i) {
    const BoxAxis axis =
        box_axis(pair, i < 3 ? unit_axis(i, 1.0f) : math::column(pair.rotation, i - 3));
    if (axis.separation > best.separation) best = axis;
  }
  if (best.separation > gap || share_an_axis(pair)) return best;
  const Vec3f ha = pair.a->scale, hb = pair.b->scale;
  const float size = ((ha.x + ha.y) + ha.z) + ((hb.x + hb.y) + hb.z);
  const float to_beat = best.separation + kEdgeBias * size;
  for (int32_t i = 0; i < 9; ++i) {
    const Vec3f n = math::cross(unit_axis(i / 3, 1.0f), math::column(pair.rotation, i % 3));
    const float sine = math::length(n);
    if (!(sine > kEdgeAxisSine)) continue;
    BoxAxis axis = box_axis(pair, n / sine);
    if (!(axis.separation > to_beat) || !(axis.separation > best.separation)) continue;
    axis.edge_a = i / 3;
    axis.edge_b = i % 3;
    best = axis;
  }
  return best;
}

// Returns the nearest points: those of the two edges of a cross axis, or a corner and its
// projection on the face.
inline Proximity box_proximity(const ShapePair& pair, const BoxAxis& axis) {
  const Vec3f n = axis.normal;
  const SupportPoint corner = support_point(pair, n);
  Proximity proximity{n, axis.separation, corner.a, corner.b};
  if (axis.edge_a >= 0) {
    const float ha = component(pair.a->scale, axis.edge_a);
    const float hb = component(pair.b->scale, axis.edge_b);
    const Vec3f u = unit_axis(axis.edge_a, 1.0f), v = math::column(pair.rotation, axis.edge_b);
    const Vec3f a = corner.a - u * math::dot(u, corner.a);  // midpoint of each edge
    const Vec3f b = corner.b - v * math::dot(v, corner.b - pair.offset);
    const SegmentPoints p = nearest_of_segments(a - u * ha, a + u * ha, b - v * hb, b + v * hb);
    proximity.on_a = p.a;
    proximity.on_b = p.b;
  } else if (math::max(math::max(math::abs(n.x), math::abs(n.y)), math::abs(n.z)) == 1.0f) {
    proximity.on_a = corner.b - n * axis.separation;
  } else {
    proximity.on_b = corner.a + n * axis.separation;
  }
  return proximity;
}

NOVAPHY_OUT_OF_LINE Manifold collide_boxes(const ShapePair& pair, float gap) {
  const BoxAxis axis = best_box_axis(pair, gap);
  if (!(axis.separation <= gap)) return {};
  const Proximity proximity = box_proximity(pair, axis);
  const ContactCandidates found = clip_candidates(pair, proximity, gap);
  bool witness_only = false;
  for (int32_t i = 0; i < found.count; ++i)
    witness_only = witness_only || (found.points[i].feature & kWitnessCode) == kWitnessCode;
  if (axis.separation > 0.0f && witness_only) return collide_convex(pair, gap);
  return reduce_contacts<kManifoldCapacity>(found);
}

}  // namespace novaphy::geometry
