// The distance of two separate convex cores (shape.h): the Gilbert-Johnson-Keerthi algorithm (GJK)
// on the Minkowski difference A - B.
//
// Let v be the point of the current simplex that is nearest to the origin. Each iteration adds the
// support point in direction -v and reduces the simplex to the face, edge or corner with the new v.
// With n = -v/|v| the support point w gives the bounds -w.n <= distance <= |v|. The result is the
// largest lower bound that the search found, with its n. A lower bound never exceeds the true
// distance.
//
// Source: Gilbert, Johnson, Keerthi (1988). The termination is that of van den Bergen, Collision
// Detection in Interactive 3D Environments (2003), 4.3. The nearest point of a triangle is computed
// from its normal. This is accurate for thin triangles, while differences of products of edges are
// not.
//
// The iteration ends after kGjkIterations, or without progress. If |v| is below kTouchingDistance
// times the size of the simplex, the cores count as touching. Rounding then dominates the direction
// of v, and EPA (epa.h) computes the result. Frame of A, m.
#pragma once

#include "novaphy/collision/geometry/support.h"

namespace novaphy::geometry {

inline constexpr int32_t kGjkIterations = 64;
inline constexpr float kGjkTolerance = 1e-6f;      // of the distance: difference of the bounds
inline constexpr float kTouchingDistance = 2e-6f;  // of the size of the simplex

struct Simplex {
  SupportPoint p[4];
  float weight[4];  // barycentric weights of the nearest point; they sum to 1
  int32_t count = 0;
};

// BEYOND: the distance exceeds the limit
enum class GjkStatus : int32_t { SEPARATE, BEYOND, TOUCHING };
struct GjkResult {
  GjkStatus status = GjkStatus::SEPARATE;
  Vec3f normal{};  // unit, from A to B
  float distance{};
  Vec3f on_a{}, on_b{};
  Simplex simplex;  // EPA starts from this simplex
};

// Finds the point of the segment p[0] p[1] nearest to the origin, and reduces the simplex to its
// feature.
inline void nearest_of_segment(Simplex& s) {
  const Vec3f a = s.p[0].w, ab = s.p[1].w - a;
  const float square = math::dot(ab, ab), t = -math::dot(a, ab);
  if (!(square > 0.0f) || t <= 0.0f) {
    s.count = 1;
    s.weight[0] = 1.0f;
  } else if (t >= square) {
    s.p[0] = s.p[1];
    s.count = 1;
    s.weight[0] = 1.0f;
  } else {
    s.weight[1] = t / square;
    s.weight[0] = 1.0f - s.weight[1];
  }
}

inline Vec3f nearest_point(const Simplex& s) {
  // For a triangle, the plane gives a more accurate point than the weighted sum of corners.
  if (s.count == 3) {
    const Vec3f n = math::cross(s.p[1].w - s.p[0].w, s.p[2].w - s.p[0].w);
    const float square = math::dot(n, n);
    if (square > 0.0f) return n * (math::dot(n, s.p[0].w) / square);
  }
  Vec3f v{};
  for (int32_t i = 0; i < s.count; ++i) v = v + s.p[i].w * s.weight[i];
  return v;
}

inline Simplex face_of(const Simplex& s, int32_t i, int32_t j, int32_t k) {
  Simplex face;
  face.p[0] = s.p[i];
  face.p[1] = s.p[j];
  if (k >= 0) face.p[2] = s.p[k];
  face.count = k >= 0 ? 3 : 2;
  return face;
}
inline void keep_nearer(Simplex& best, float& best_square, const Simplex& candidate) {
  const Vec3f v = nearest_point(candidate);
  const float square = math::dot(v, v);
  if (best_square < 0.0f || square < best_square) {
    best = candidate;
    best_square = square;
  }
}

inline void nearest_of_triangle(Simplex& s) {
  const Vec3f a = s.p[0].w, b = s.p[1].w, c = s.p[2].w;
  const Vec3f n = math::cross(b - a, c - a);
  const float u = math::dot(n, math::cross(b, c)), v = math::dot(n, math::cross(c, a)),
              w = math::dot(n, math::cross(a, b)), sum = (u + v) + w;
  if (u > 0.0f && v > 0.0f && w > 0.0f) {
    s.weight[0] = u / sum;
    s.weight[1] = v / sum;
    s.weight[2] = w / sum;
    return;
  }
  Simplex best;
  float best_square = -1.0f;
  for (int32_t i = 0; i < 3; ++i) {
    Simplex edge = face_of(s, i, (i + 1) % 3, -1);
    nearest_of_segment(edge);
    keep_nearer(best, best_square, edge);
  }
  s = best;
}

// Returns whether the tetrahedron contains the origin. If not, reduces s to the nearest face, edge
// or corner. A flat tetrahedron has no inside, so all its faces are tested.
inline bool nearest_of_tetrahedron(Simplex& s) {
  Simplex best;
  float best_square = -1.0f;
  bool outside = false;
  for (int32_t i = 0; i < 4; ++i) {
    const int32_t j = (i + 1) % 4, k = (i + 2) % 4, opposite = (i + 3) % 4;
    const Vec3f a = s.p[i].w;
    const Vec3f n = math::cross(s.p[j].w - a, s.p[k].w - a);
    const float inner = math::dot(n, s.p[opposite].w - a), origin = -math::dot(n, a);
    if (inner > 0.0f ? origin > 0.0f : inner < 0.0f ? origin < 0.0f : false) continue;
    outside = true;
    Simplex face = face_of(s, i, j, k);
    nearest_of_triangle(face);
    keep_nearer(best, best_square, face);
  }
  if (outside) s = best;
  return !outside;
}

// Reduces the simplex to the feature nearest to the origin. Returns whether the simplex contains
// the origin.
NOVAPHY_OUT_OF_LINE bool cut_to_nearest(Simplex& s) {
  if (s.count == 1) s.weight[0] = 1.0f;
  if (s.count == 2) nearest_of_segment(s);
  if (s.count == 3) nearest_of_triangle(s);
  return s.count == 4 && nearest_of_tetrahedron(s);
}

inline bool has_vertex(const Simplex& s, const Vec3f& w) {
  for (int32_t i = 0; i < s.count; ++i)
    if (s.p[i].w == w) return true;
  return false;
}

// Computes the distance of a pair (m). The search stops as soon as a lower bound of the distance
// exceeds `limit` (m).
NOVAPHY_OUT_OF_LINE GjkResult gjk(const ShapePair& pair, float limit) {
  GjkResult result;
  Simplex& s = result.simplex;
  const Vec3f start = pair.offset == Vec3f{} ? Vec3f{1.0f, 0.0f, 0.0f} : pair.offset;
  s.p[0] = support_point(pair, math::normalize(start));
  s.count = 1;
  s.weight[0] = 1.0f;
  Vec3f v = s.p[0].w;
  float size = math::length(v), best = -1.0f;
  for (int32_t i = 0; i < kGjkIterations; ++i) {
    const float upper = math::length(v);
    if (!(upper > kTouchingDistance * size)) {
      result.status = GjkStatus::TOUCHING;
      return result;
    }
    const Vec3f n = v * (-1.0f / upper);
    const SupportPoint p = support_point(pair, n);
    const float lower = -math::dot(p.w, n);
    if (lower > best) {
      best = lower;
      result.normal = n;
    }
    if (best > limit) {
      result.status = GjkStatus::BEYOND;
      result.distance = best;
      return result;
    }
    if (upper - lower <= kGjkTolerance * upper || has_vertex(s, p.w)) break;
    const Simplex before = s;
    s.p[s.count++] = p;
    size = math::max(size, math::length(p.w));
    if (cut_to_nearest(s)) {
      result.status = GjkStatus::TOUCHING;
      return result;
    }
    const Vec3f next = nearest_point(s);
    if (!(math::dot(next, next) < upper * upper)) {  // rounding: no progress
      s = before;
      break;
    }
    v = next;
  }
  // Without a separating direction, rounding has hidden an overlap.
  if (!(best > 0.0f)) result.status = GjkStatus::TOUCHING;
  result.distance = best;
  for (int32_t i = 0; i < s.count; ++i) {
    result.on_a = result.on_a + s.p[i].a * s.weight[i];
    result.on_b = result.on_b + s.p[i].b * s.weight[i];
  }
  return result;
}

}  // namespace novaphy::geometry
