// The penetration of two convex cores (shape.h) that touch or overlap: the expanding polytope
// algorithm (EPA) on the Minkowski difference A - B.
//
// A polytope of support points grows inside of the difference. The face nearest to the origin gives
// a lower bound of the depth. The support function h(n) along the face's normal n is an upper
// bound: A and B separate when they move apart by h(n) along n. The result is the smallest h(n)
// that the search found with its n. The growth ends when both bounds agree within kEpaTolerance
// times the size of the difference, when the workspace is full, or when rounding prevents progress.
//
// Distances of faces are signed. The orientation of a face follows from the polytope. The origin
// cannot give the orientation, because it may lie on the surface or just outside (a touching
// contact with depth 0 or < 0). Source: van den Bergen, Proximity Queries and Penetration Depth
// Computation on 3D Game Objects (2001).
//
// A flat difference has no volume, for example for crossing segments. The cores then separate along
// the normal of its plane. Frame of A.
#pragma once

#include "novaphy/collision/geometry/gjk.h"

namespace novaphy::geometry {

inline constexpr int32_t kEpaVertices = 96;
inline constexpr int32_t kEpaFaces = 2 * kEpaVertices;
inline constexpr int32_t kEpaEdges = 64;       // most edges of the hole for a new vertex
inline constexpr float kEpaTolerance = 5e-7f;  // of the size
inline constexpr float kEpaFlat = 1e-6f;       // of the size: smallest height of a tetrahedron
inline constexpr float kNoFace = 3.0e38f;

struct Penetration {
  Vec3f normal{1.0f, 0.0f, 0.0f};  // unit, from A to B
  float depth = kNoFace;           // m, depth of the cores
  Vec3f on_a{}, on_b{};
};

struct EpaFace {
  int32_t v[3];
  Vec3f normal;
  float offset;  // m, signed distance of the plane from the origin; kNoFace: no area
};
struct EpaPolytope {
  SupportPoint vertex[kEpaVertices];
  EpaFace face[kEpaFaces];
  int32_t vertex_count = 0, face_count = 0;
};
struct EpaEdges {
  int32_t from[kEpaEdges], to[kEpaEdges];
  int32_t count = 0;
  bool full = false;
};

inline void add_face(EpaPolytope& poly, int32_t i, int32_t j, int32_t k) {
  EpaFace& f = poly.face[poly.face_count++];
  f.v[0] = i;
  f.v[1] = j;
  f.v[2] = k;
  const Vec3f a = poly.vertex[i].w, b = poly.vertex[j].w, c = poly.vertex[k].w;
  const Vec3f n = math::cross(b - a, c - a);
  f.normal = math::normalize(n);
  f.offset = math::dot(n, n) > 0.0f ? math::dot(f.normal, a) : kNoFace;
}

// Adds an edge of the hole. An edge that two removed faces share is in the interior of the hole,
// and is removed from the list.
inline void toggle_edge(EpaEdges& edges, int32_t from, int32_t to) {
  for (int32_t i = 0; i < edges.count; ++i)
    if (edges.from[i] == to && edges.to[i] == from) {
      --edges.count;
      edges.from[i] = edges.from[edges.count];
      edges.to[i] = edges.to[edges.count];
      return;
    }
  if (edges.count == kEpaEdges) {
    edges.full = true;
    return;
  }
  edges.from[edges.count] = from;
  edges.to[edges.count++] = to;
}

// Sets the points of A and B for the projection of the origin on a face.
inline void set_witness(Penetration& best, const EpaPolytope& poly, const EpaFace& face) {
  Simplex s;
  s.count = 3;
  const Vec3f foot = face.normal * face.offset;
  for (int32_t i = 0; i < 3; ++i) {
    s.p[i] = poly.vertex[face.v[i]];
    s.p[i].w = s.p[i].w - foot;
  }
  nearest_of_triangle(s);
  best.on_a = best.on_b = {};
  for (int32_t i = 0; i < s.count; ++i) {
    best.on_a = best.on_a + s.p[i].a * s.weight[i];
    best.on_b = best.on_b + s.p[i].b * s.weight[i];
  }
}

// Tests the direction n. If the cores separate by a shorter distance along n than along the best
// direction so far, n becomes the best direction.
inline SupportPoint query_direction(const ShapePair& pair, const Vec3f& n, Penetration& best,
                                    bool& better) {
  const SupportPoint p = support_point(pair, n);
  const float h = math::dot(p.w, n);
  better = h < best.depth;
  if (better) {
    best.depth = h;
    best.normal = n;
    best.on_a = p.a;
    best.on_b = p.b;
  }
  return p;
}

// Grows a simplex to a tetrahedron with volume. Returns false if the difference is flat. `best`
// then has the direction perpendicular to the flat difference.
NOVAPHY_OUT_OF_LINE bool grow_tetrahedron(const ShapePair& pair, Simplex& s, float& size,
                                          Penetration& best) {
  bool better = false;
  auto farthest = [&](const Vec3f& n, auto distance) {
    SupportPoint p = support_point(pair, n);
    const SupportPoint q = support_point(pair, -n);
    if (math::abs(distance(q.w)) > math::abs(distance(p.w))) p = q;
    size = math::max(size, math::length(p.w));
    s.p[s.count++] = p;
    return math::abs(distance(p.w)) > kEpaFlat * size;
  };
  for (int32_t i = 0; i < s.count; ++i) size = math::max(size, math::length(s.p[i].w));
  if (s.count == 4) {  // the tetrahedron of GJK may be flat
    const Vec3f a = s.p[0].w;
    const Vec3f n = math::normalize(math::cross(s.p[1].w - a, s.p[2].w - a));
    if (math::abs(math::dot(n, s.p[3].w - a)) > kEpaFlat * size) return true;
    s.count = 3;
  }
  if (s.count == 3) {
    const Vec3f a = s.p[0].w, ab = s.p[1].w - a;
    if (!(math::length(math::cross(ab, s.p[2].w - a)) > kEpaFlat * size * math::length(ab)))
      s.count = 2;
  }
  if (s.count == 2 && !(math::length(s.p[1].w - s.p[0].w) > kEpaFlat * size)) s.count = 1;
  if (s.count == 1) {
    const Vec3f a = s.p[0].w;
    bool found = false;
    for (int32_t i = 0; i < 3 && !found; ++i) {
      s.count = 1;
      found = farthest(unit_axis(i, 1.0f), [&](const Vec3f& w) { return math::length(w - a); });
    }
    if (!found) {  // the difference is a single point
      query_direction(pair, {1.0f, 0.0f, 0.0f}, best, better);
      return false;
    }
  }
  if (s.count == 2) {
    const Vec3f a = s.p[0].w, d = math::normalize(s.p[1].w - a), u = any_orthogonal(d);
    auto off_line = [&](const Vec3f& w) { return math::length(math::cross(w - a, d)); };
    if (!farthest(u, off_line)) {
      s.count = 2;
      if (!farthest(math::cross(d, u), off_line)) {  // the difference is a line
        query_direction(pair, u, best, better);
        return false;
      }
    }
  }
  const Vec3f a = s.p[0].w;
  const Vec3f n = math::normalize(math::cross(s.p[1].w - a, s.p[2].w - a));
  s.count = 3;
  if (farthest(n, [&](const Vec3f& w) { return math::dot(n, w - a); })) return true;
  query_direction(pair, n, best, better);
  query_direction(pair, -n, best, better);
  return false;
}

inline void start_polytope(EpaPolytope& poly, const Simplex& s) {
  for (int32_t i = 0; i < 4; ++i) poly.vertex[i] = s.p[i];
  poly.vertex_count = 4;
  const Vec3f a = s.p[0].w;
  const Vec3f n = math::cross(s.p[1].w - a, s.p[2].w - a);
  const bool below = math::dot(n, s.p[3].w - a) < 0.0f;  // p[3] is on the inner side of face 0 1 2
  const int32_t j = below ? 1 : 2, k = below ? 2 : 1;
  add_face(poly, 0, j, k);
  add_face(poly, 0, k, 3);
  add_face(poly, k, j, 3);
  add_face(poly, j, 0, 3);
}

// Adds a vertex outside of the face `from`, and removes all faces that are visible from the vertex.
// Returns false if the workspace is full.
NOVAPHY_OUT_OF_LINE bool add_vertex(EpaPolytope& poly, const SupportPoint& p, int32_t from,
                                    float tolerance) {
  EpaEdges edges;
  int32_t kept = 0;
  const int32_t count = poly.face_count, vertex = poly.vertex_count;
  for (int32_t i = 0; i < count; ++i) {
    const EpaFace face = poly.face[i];
    const bool sees = i == from || (face.offset != kNoFace &&
                                    math::dot(face.normal, p.w) - face.offset > tolerance);
    if (sees) {
      for (int32_t k = 0; k < 3; ++k) toggle_edge(edges, face.v[k], face.v[(k + 1) % 3]);
    } else {
      poly.face[kept++] = face;
    }
  }
  poly.face_count = kept;
  if (edges.full || kept + edges.count > kEpaFaces || vertex == kEpaVertices) return false;
  poly.vertex[poly.vertex_count++] = p;
  for (int32_t i = 0; i < edges.count; ++i) add_face(poly, edges.from[i], edges.to[i], vertex);
  return true;
}

NOVAPHY_OUT_OF_LINE Penetration epa(const ShapePair& pair, const Simplex& start) {
  Simplex simplex = start;  // parameters are not passed by value: docs/design/0023
  Penetration best;
  float size = 0.0f;
  if (!grow_tetrahedron(pair, simplex, size, best)) return best;
  EpaPolytope poly;
  start_polytope(poly, simplex);
  const float tolerance = kEpaTolerance * size;
  for (int32_t i = 0; i < 2 * kEpaVertices; ++i) {
    int32_t nearest = -1;
    for (int32_t k = 0; k < poly.face_count; ++k)
      if (poly.face[k].offset != kNoFace &&
          (nearest < 0 || poly.face[k].offset < poly.face[nearest].offset))
        nearest = k;
    if (nearest < 0 || poly.face[nearest].offset >= best.depth - tolerance) break;
    const EpaFace face = poly.face[nearest];
    bool better = false;
    const SupportPoint p = query_direction(pair, face.normal, best, better);
    if (better) set_witness(best, poly, face);
    if (math::dot(p.w, face.normal) - face.offset <= tolerance) break;
    if (!add_vertex(poly, p, nearest, 0.2f * tolerance)) break;
  }
  return best;
}

}  // namespace novaphy::geometry
