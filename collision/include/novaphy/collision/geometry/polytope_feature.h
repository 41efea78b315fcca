// The face, edge or corner of a convex hull or a triangle mesh at a point of its surface, for the
// gradients of contacts. Frame of the shape, m.
#pragma once

#include "novaphy/collision/geometry/geometry_view.h"

namespace novaphy::geometry {

// All flags are false: no feature is at the point, or the shape is neither a hull nor a mesh.
struct PolytopeFeature {
  bool is_face = false, is_edge = false, is_corner = false;
  bool leads = false;  // an edge or a corner whose contact normal is that of one of its faces
  bool is_along = false;  // the contact normal is that of a face at the point
  Vec3f line{};           // unit vector along an edge
  // An edge of a hull: the normal of its face by which the search clips the other shape. 0: none.
  Vec3f clips{};
  float aside = 0.0f;  // m: the distance of the point from the edges of that face, in its plane
};

namespace polytope_detail {

inline constexpr float kOn = 1e-4f;      // of the shape's size: the distance of a point from a face
inline constexpr float kSame = 1.4e-3f;  // rad: normals of one face
inline constexpr float kAlong = 3e-4f;   // rad: a contact normal along the normal of a face
inline constexpr float kWithin = 4e-3f;  // rad: the same inside of a face, from any search
inline constexpr float kClips = 0.99863f;  // equal to kFaceCosine of clip_manifold.h

inline bool is_parallel(const Vec3f& a, const Vec3f& b, float angle) {
  const Vec3f c = math::cross(a, b);
  return math::dot(c, c) < angle * angle;
}

// The faces at a point, of which faces with the same normal count once.
struct FacesAt {
  Vec3f first{}, line{};
  int32_t count = 0;  // 3: three or more without a common edge
  bool is_along = false, is_within = false;
  Vec3f closest{};       // the face closest to the contact normal
  float cosine = -1.0f;  // of the angle between both
  float aside = 0.0f;    // PolytopeFeature

  // `inside`: from is_on_face.
  void add(const Vec3f& face, const Vec3f& normal, float inside) {
    is_along = is_along || is_parallel(face, normal, kAlong);
    is_within = is_within || is_parallel(face, normal, kWithin);
    const float aligned = math::abs(math::dot(face, normal));
    if (aligned > cosine) {
      closest = face;
      cosine = aligned;
      aside = math::abs(inside);
    }
    if (count == 0) {
      first = face;
      count = 1;
    } else if (count == 1 && !is_parallel(face, first, kSame)) {
      line = math::normalize(math::cross(first, face));
      count = 2;
    } else if (count == 2 && math::abs(math::dot(face, line)) > kSame) {
      count = 3;
    }
  }
  PolytopeFeature feature(bool is_hull) const {
    PolytopeFeature f;
    f.is_face = count == 1 && is_within;
    f.is_edge = count == 2;
    f.is_corner = count == 3;
    f.leads = count > 1 && is_along;
    f.is_along = is_along;
    f.line = line;
    if (is_hull && f.is_edge && cosine >= kClips) {
      f.clips = closest;
      f.aside = aside;
    }
    return f;
  }
};

// Returns whether x lies on a face: within `on` of its plane and inside of its outline.
// `corner(k)`: its `count` corners, counterclockwise about the normal n. `least`: the distance of x
// from the closest side of the outline.
template <class Corner>
bool is_on_face(int32_t count, const Corner& corner, const Vec3f& n, const Vec3f& x, float on,
                float& least) {
  if (math::abs(math::dot(n, x - corner(0))) > on) return false;
  for (int32_t k = 0; k < count; ++k) {
    const Vec3f edge = corner((k + 1) % count) - corner(k);
    const float length = math::sqrt(math::dot(edge, edge));
    const float inside = math::dot(math::cross(n, edge), x - corner(k));
    if (inside < -on * length) return false;
    if (k == 0 || inside < least * length) least = inside / length;
  }
  return true;
}

inline FacesAt hull_faces_at(const HullView& hull, const Vec3f& x, const Vec3f& normal, float on) {
  FacesAt faces;
  for (int32_t i = 0; i < hull.face_count; ++i) {
    const int32_t first = hull.face_starts[i];
    const auto corner = [&](int32_t k) { return hull.vertices[hull.face_vertices[first + k]]; };
    float inside = 0.0f;
    if (is_on_face(hull.face_starts[i + 1] - first, corner, hull.face_normals[i], x, on, inside))
      faces.add(hull.face_normals[i], normal, inside);
  }
  return faces;
}

inline bool is_on_triangle(const MeshView& mesh, int32_t triangle, const Vec3f& x, float on) {
  float least = 0.0f;
  const Vec3i& t = mesh.triangles[triangle];
  const Vec3f corners[3] = {mesh.vertices[t.x], mesh.vertices[t.y], mesh.vertices[t.z]};
  const Vec3f n = mesh.normals[triangle];
  return math::dot(n, n) >= 0.5f && is_on_face(
                                        3, [&](int32_t k) { return corners[k]; }, n, x, on, least);
}
inline FacesAt mesh_faces_at(const MeshView& mesh, const Vec3f& x, const Vec3f& normal, float on) {
  FacesAt faces;
  const Vec3f reach = {on, on, on};
  for_triangles_in(mesh, {x - reach, x + reach}, [&](int32_t triangle) {
    if (is_on_triangle(mesh, triangle, x, on)) faces.add(mesh.normals[triangle], normal, 0.0f);
  });
  return faces;
}

}  // namespace polytope_detail

// Returns the feature of a hull or a mesh at the point x. `normal`: the contact normal (unit).
inline PolytopeFeature polytope_feature(const GeometryView& shape, const Vec3f& x,
                                        const Vec3f& normal) {
  const Vec3f size = shape.box.hi - shape.box.lo;
  const float on = math::max(size.x, math::max(size.y, size.z)) * polytope_detail::kOn;
  const bool is_hull = shape.hull.face_count > 0;
  return (is_hull ? polytope_detail::hull_faces_at(shape.hull, x, normal, on)
                  : polytope_detail::mesh_faces_at(shape.mesh, x, normal, on))
      .feature(is_hull);
}

}  // namespace novaphy::geometry
