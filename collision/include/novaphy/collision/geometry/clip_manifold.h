// Computes the contact manifold of two shapes with a known normal, distance and nearest points. The
// supporting feature (face, edge or point) of one shape is clipped against that of the other shape.
//
// The reference feature is the face that is aligned best with the normal, within kFaceCosine. The
// other feature, a face or an edge, is clipped by the planes through the edges of the reference
// face (Sutherland, Hodgman 1974). The distance of each corner is measured along the normal to the
// plane of the reference. Two nearly parallel edges (kParallelSine) are clipped by the planes
// through the ends of the first edge. All other features touch in one point.
//
// No corner gets a larger depth than the known depth of the pair. If no corner reaches this depth
// (round rims, edges on edges), the nearest points are added. The deepest point of the manifold
// therefore always has the distance of the pair.
//
// The normal may differ from the normal of the reference face: it may be an edge axis that is
// slightly better than a nearly parallel face. The manifold is still that of the faces, which keeps
// stacks stable. Frame of A, m.
#pragma once

#include "novaphy/collision/geometry/feature.h"
#include "novaphy/collision/geometry/manifold.h"

namespace novaphy::geometry {

inline constexpr float kFaceCosine = 0.99863f;   // 3 deg
inline constexpr float kParallelSine = 0.0349f;  // 2 deg
inline constexpr float kFacePreference = 1e-4f;  // of the cosine: preference for the face of A
inline constexpr float kDeepestShare = 4e-6f;    // of the features' size: tolerance of depths
inline constexpr int32_t kClipCapacity = 2 * kFeatureCapacity;

// The signed distance, the normal from A to B, and the nearest points of the surfaces of a pair.
struct Proximity {
  Vec3f normal{};
  float distance{};
  Vec3f on_a{}, on_b{};
};

struct ClippedFeature {
  Vec3f points[kClipCapacity];
  int32_t codes[kClipCapacity];  // i: corner i; 16 + 2 k: on plane k (+ 1: the outline enters)
  int32_t count = 0;
  bool open = false;  // whether the feature is an edge instead of a polygon
};

inline void add_clipped(ClippedFeature& out, const Vec3f& point, int32_t code) {
  if (out.count == kClipCapacity) return;
  out.points[out.count] = point;
  out.codes[out.count++] = code;
}

// Returns the part of the feature with dot(normal, x) <= offset.
NOVAPHY_OUT_OF_LINE ClippedFeature clip_by_plane(const ClippedFeature& in, const Vec3f& normal,
                                                 float offset, int32_t plane) {
  ClippedFeature out;
  out.open = in.open;
  for (int32_t i = 0; i < in.count; ++i) {
    const float d = math::dot(normal, in.points[i]) - offset;
    if (d <= 0.0f) add_clipped(out, in.points[i], in.codes[i]);
    if (in.open && i + 1 == in.count) break;
    const int32_t j = i + 1 == in.count ? 0 : i + 1;
    const float e = math::dot(normal, in.points[j]) - offset;
    if ((d <= 0.0f) == (e <= 0.0f)) continue;
    const Vec3f cut = in.points[i] + (in.points[j] - in.points[i]) * (d / (d - e));
    add_clipped(out, cut, 16 + 2 * plane + (d > 0.0f ? 1 : 0));
  }
  return out;
}

inline ClippedFeature unclipped(const Feature& feature) {
  ClippedFeature out;
  out.open = feature.count == 2;
  for (int32_t i = 0; i < feature.count; ++i) add_clipped(out, feature.points[i], i);
  return out;
}

inline float extent(const Feature& feature) {
  float square = 0.0f;
  for (int32_t i = 1; i < feature.count; ++i) {
    const Vec3f d = feature.points[i] - feature.points[0];
    square = math::max(square, math::dot(d, d));
  }
  return math::sqrt(square);
}

inline ClippedFeature clip_to_face(const Feature& face, const Feature& incident) {
  ClippedFeature clipped = unclipped(incident);
  for (int32_t k = 0; k < face.count; ++k) {
    const Vec3f a = face.points[k], b = face.points[k + 1 == face.count ? 0 : k + 1];
    const Vec3f side = math::normalize(math::cross(b - a, face.normal));
    clipped = clip_by_plane(clipped, side, math::dot(side, a), k);
  }
  return clipped;
}
// Returns whether a point lies over a face. Equals clip_to_face with a point.
inline bool is_over_face(const Feature& face, const Vec3f& point) {
  for (int32_t k = 0; k < face.count; ++k) {
    const Vec3f a = face.points[k], b = face.points[k + 1 == face.count ? 0 : k + 1];
    const Vec3f side = math::normalize(math::cross(b - a, face.normal));
    if (!(math::dot(side, point) - math::dot(side, a) <= 0.0f)) return false;
  }
  return true;
}
inline ClippedFeature clip_to_edge(const Feature& edge, const Feature& incident) {
  const Vec3f d = math::normalize(edge.points[1] - edge.points[0]);
  ClippedFeature clipped = clip_by_plane(unclipped(incident), d, math::dot(d, edge.points[1]), 1);
  return clip_by_plane(clipped, -d, -math::dot(d, edge.points[0]), 0);
}

// Returns the normal of the reference plane: the plane of the face, or the plane through the edge
// whose normal is closest to n.
inline Vec3f reference_normal(const Feature& reference, const Vec3f& n) {
  if (reference.count > 2) return reference.normal;
  const Vec3f d = math::normalize(reference.points[1] - reference.points[0]);
  return math::normalize(n - d * math::dot(n, d));
}

// Returns whether both features are edges that are nearly parallel and nearly perpendicular to n.
inline bool edges_run_along(const Feature& a, const Feature& b, const Vec3f& n) {
  if (a.count != 2 || b.count != 2) return false;
  const Vec3f u = math::normalize(a.points[1] - a.points[0]);
  const Vec3f v = math::normalize(b.points[1] - b.points[0]);
  return math::length(math::cross(u, v)) < kParallelSine &&
         math::abs(math::dot(u, n)) < kParallelSine && math::abs(math::dot(v, n)) < kParallelSine;
}

// Computes the features of both shapes that face each other along n.
inline void facing_features(const ShapePair& pair, const Vec3f& n, Feature& a, Feature& b) {
  a = supporting_feature(*pair.a, n);
  b = supporting_feature(*pair.b, apply_transposed(pair.rotation, -n));
  for (int32_t i = 0; i < b.count; ++i) b.points[i] = from_b(pair, b.points[i]);
  b.normal = apply(pair.rotation, b.normal);
}

// Adds the points of one feature that lie over the reference feature and within the gap. The
// reference is A's feature if a_leads, else B's. Returns whether a point is as deep as the pair.
NOVAPHY_OUT_OF_LINE bool clip_features(const ShapePair& pair, const Proximity& proximity,
                                       const Feature& a, const Feature& b, bool a_leads, float gap,
                                       ContactCandidates& found) {
  const Feature& reference = a_leads ? a : b;
  const Feature& incident = a_leads ? b : a;
  const ClippedFeature clipped =
      reference.count > 2 ? clip_to_face(reference, incident) : clip_to_edge(reference, incident);
  // Direction from the reference to the other shape.
  const Vec3f away = a_leads ? proximity.normal : -proximity.normal;
  const Vec3f plane = reference_normal(reference, away);
  const float cosine = math::dot(plane, away);
  const float radius = core_radius(*pair.a) + core_radius(*pair.b);
  const float shift = core_radius(a_leads ? *pair.b : *pair.a);
  const float tolerance = kDeepestShare * math::max(extent(a), extent(b));
  bool as_deep = false;
  for (int32_t i = 0; i < clipped.count; ++i) {
    const Vec3f p = clipped.points[i];
    const float core = math::dot(plane, p - reference.points[0]) / cosine;
    const float distance = math::max(core - radius, proximity.distance);
    if (!(distance <= gap)) continue;
    as_deep = as_deep || distance <= proximity.distance + tolerance;
    // The surface is `shift` in front of the core point p. The contact point is half a distance
    // further.
    add_contact(found, p - away * (shift + 0.5f * distance), distance,
                contact_feature(a.face, b.face, clipped.codes[i]));
  }
  return as_deep;
}

// Returns the points of two features whose distance is at most `gap` (m), before reduction.
NOVAPHY_OUT_OF_LINE ContactCandidates clip_candidates(const ShapePair& pair,
                                                      const Proximity& proximity, const Feature& a,
                                                      const Feature& b, float gap) {
  const Vec3f n = proximity.normal;
  const float along_a = a.count > 2 ? math::dot(a.normal, n) : -1.0f;
  const float along_b = b.count > 2 ? -math::dot(b.normal, n) : -1.0f;
  const bool a_leads = a.count > 2 ? !(along_b > along_a + kFacePreference) : b.count == 2;
  const bool faces =
      math::max(along_a, along_b) >= kFaceCosine && (a_leads ? b.count : a.count) > 1;
  ContactCandidates found;
  found.normal = n;
  const bool as_deep = (faces || edges_run_along(a, b, n)) &&
                       clip_features(pair, proximity, a, b, a_leads, gap, found);
  if (!as_deep)
    add_contact(found, (proximity.on_a + proximity.on_b) * 0.5f, proximity.distance,
                contact_feature(a.face, b.face, kWitnessCode));
  return found;
}
inline ContactCandidates clip_candidates(const ShapePair& pair, const Proximity& proximity,
                                         float gap) {
  Feature a, b;
  facing_features(pair, proximity.normal, a, b);
  return clip_candidates(pair, proximity, a, b, gap);
}

NOVAPHY_OUT_OF_LINE Manifold clip_manifold(const ShapePair& pair, const Proximity& proximity,
                                           float gap) {
  if (!(proximity.distance <= gap)) return {};
  return reduce_contacts<kManifoldCapacity>(clip_candidates(pair, proximity, gap));
}

}  // namespace novaphy::geometry
