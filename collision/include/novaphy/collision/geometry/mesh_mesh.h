// Contacts of two triangle meshes, convex or not, before the reduction of mesh_pair.h. As for any
// two polyhedra, a contact has one of two kinds:
//
// Vertices of each mesh on the other mesh (vertices_on_mesh). For a vertex outside, the normal is
// that of the nearest surface point (point_to_mesh). For a vertex inside, the normal is that of the
// nearest face over the vertex. In a concave edge or corner no face lies over the vertex. Two or
// three neighboring faces then each give a normal, with the distance to their plane (faces_over).
//
// A normal is valid only if the mesh around the vertex lies on the outer side of the face. The test
// checks each edge from the vertex to a neighbor. The edge may point inward by at most the sine
// kStandSine. A mesh that lies flush against a side face is therefore not pushed out through that
// side face.
//
// Edges on edges (edges_on_edges), for border edges and convex edges. The normal is perpendicular
// to both edges and must lie in the normal cones of both. In an overlap each contact point must lie
// in or on the other mesh. If several contacts at one place have different directions, only the
// contact with the smallest overlap remains (drop_long_ways).
//
// Inside and outside are defined as in point_to_mesh: a closed mesh has an inside, and an open mesh
// has a side behind its triangles. Contacts of vertices push out a part that is deep inside of a
// closed mesh. Every loop runs over vertices, edges or tree nodes. The time is therefore bounded,
// and the order of the results is fixed. Frame of A, m.
#pragma once

#include "novaphy/collision/geometry/mesh_pair.h"
#include "novaphy/collision/geometry/point_distance.h"

namespace novaphy::geometry {

inline constexpr float kStandSine = 0.3f;      // about 17 deg
inline constexpr float kMeshTouch = 1e-5f;     // of the size: this near counts as on the surface
inline constexpr float kOverFace = 1e-4f;      // of an edge: counts as over the face
inline constexpr float kBeside = 0.01f;        // of the size: allowed offset beside a face
inline constexpr float kCrossingSine = 1e-2f;  // edges closer to parallel have no contact
inline constexpr float kMeshNear = 0.1f;       // of the size: see mesh_reach
inline constexpr int32_t kEdgeFeature = 16;    // features >= this value are contacts of edges
inline constexpr int32_t kVertexKinds = 8;     // features per vertex of B; those of A follow
inline constexpr float kFarDeeper = 10.0f;

// Search distances. The search leaves out contacts beyond the gap, and contacts beyond the margins
// plus a tenth of the smaller mesh. Pairs of edges have a smaller limit, also for overlaps: the
// margins plus this tenth or the longest edge of both meshes. Contacts of vertices cover deeper
// overlaps.
struct MeshReach {
  float size, gap, edges;  // m
};
inline MeshReach mesh_reach(const GeometryView& a, const GeometryView& b, float gap,
                            float margins) {
  MeshReach reach;
  reach.size = math::min(math::length(a.box.hi - a.box.lo), math::length(b.box.hi - b.box.lo));
  const float near = kMeshNear * reach.size;
  reach.gap = math::min(gap, margins + near);
  reach.edges = margins + math::min(near, math::max(a.mesh.longest_edge, b.mesh.longest_edge));
  return reach;
}

// A mesh with its pose in the frame of the other mesh.
struct PlacedMesh {
  const MeshView* mesh;
  Transformf pose;

  Vec3f at(int32_t vertex) const { return math::transform_point(pose, mesh->vertices[vertex]); }
  // Returns whether the mesh around the vertex lies on the side to which n points.
  bool stands(int32_t vertex, const Vec3f& n) const {
    const Vec3f along = math::rotate_inverse(pose.q, n), x = mesh->vertices[vertex];
    for (int32_t i = mesh->ring_starts[vertex]; i < mesh->ring_starts[vertex + 1]; ++i) {
      const Vec3f d = mesh->vertices[mesh->ring[i]] - x;
      if (math::dot(along, d) < -kStandSine * math::length(d)) return false;
    }
    return true;
  }
};

// Returns a number from 1 to 6 for the dominant axis and sign of n. The number stays the same for
// most small rotations, and distinguishes the contacts of one vertex.
inline int32_t side_of_normal(const Vec3f& n) {
  const float x = math::abs(n.x), y = math::abs(n.y), z = math::abs(n.z);
  const int32_t axis = x >= y && x >= z ? 0 : y >= z ? 1 : 2;
  return 1 + 2 * axis + (component(n, axis) < 0.0f ? 0 : 1);
}

// The faces that push out a vertex that is in or on a mesh. In general this is the nearest face. In
// a concave edge or corner these are several faces, one for each value of side_of_normal.
struct FacePoint {
  Vec3f normal{};
  float distance = -kFarAway;
};
struct FacesOver {
  FacePoint over;       // the nearest face over the point
  FacePoint beside[6];  // for each side: the nearest face that the point is slightly beside
};
inline FacesOver faces_over(const MeshView& onto, const PlacedMesh& of, int32_t vertex,
                            const Vec3f& x, const MeshReach& reach) {
  FacesOver found;
  const float touch = kMeshTouch * reach.size, slack = kBeside * reach.size;
  float nearest = kFarAway;
  for (int32_t i = 0; i < onto.node_count;) {
    const MeshNode& node = onto.nodes[i];
    // Upper bound of the distance of faces that can still change the result.
    const float bound = 3.0f * (kLongWay * nearest + slack) + slack;
    if (square_outside(node.box, x) > bound * bound) {
      i = node.skip;
      continue;
    }
    for (int32_t k = node.first; k < node.first + node.count; ++k) {
      const int32_t t = onto.order[k];
      const Vec3f n = onto.normals[t];
      const Vec3i c = onto.triangles[t];
      const Vec3f v[3] = {onto.vertices[c.x], onto.vertices[c.y], onto.vertices[c.z]};
      const float distance = math::dot(n, x - v[0]);
      if (n == Vec3f{} || !(distance <= touch)) continue;
      float beside = 0.0f;
      for (int32_t e = 0; e < 3; ++e) {
        const Vec3f edge = v[(e + 1) % 3] - v[e];
        const float length = math::length(edge);
        beside = math::max(
            beside, -math::dot(math::cross(edge, x - v[e]), n) / length - kOverFace * length);
      }
      FacePoint& best = beside > 0.0f ? found.beside[side_of_normal(n) - 1] : found.over;
      // This form of the comparison fails for NaN.
      if (!(distance > best.distance) || !(beside <= slack + kLongWay * math::abs(distance)) ||
          !of.stands(vertex, n))
        continue;
      best = {n, distance};
      nearest = math::min(nearest, math::abs(distance));
    }
    ++i;
  }
  // If a face over the point is nearer than the faces beside it, only that face counts.
  bool hollow = false;
  for (const FacePoint& face : found.beside) hollow = hollow || face.distance > found.over.distance;
  if (hollow) found.over = {};
  for (FacePoint& face : found.beside)
    if (!hollow || face.distance < -(kLongWay * nearest + slack)) face = {};
  return found;
}

// Calls emit(vertex, feature, x, normal, distance) for the vertices of a mesh on another mesh. The
// position x and the outward normal are in the frame of the other mesh.
template <class Emit>
void vertices_on_mesh(const MeshView& onto, const PlacedMesh& of, const MeshReach& reach,
                      Emit emit) {
  const float touch = kMeshTouch * reach.size;
  // A point of the surface near the previous vertex. It bounds the distance of the next vertex.
  Vec3f known{};
  float knows = kFarAway;
  for (int32_t vertex = 0; vertex < of.mesh->vertex_count; ++vertex) {
    if (of.mesh->ring_starts[vertex] == of.mesh->ring_starts[vertex + 1]) continue;
    const Vec3f x = of.at(vertex);
    const float within = math::max(knows, 1.01f * math::length(x - known) + kBeside * reach.size);
    const SolidPoint at = point_to_mesh(x, onto, reach.gap, within);
    if (at.distance < kFarAway) {
      known = x - at.normal * at.distance;
      knows = 0.0f;
    }
    if (!(at.distance <= reach.gap)) continue;
    if (at.distance > touch) {
      if (of.stands(vertex, at.normal)) emit(vertex, 0, x, at.normal, at.distance);
      continue;
    }
    const FacesOver faces = faces_over(onto, of, vertex, x, reach);
    const auto take = [&](const FacePoint& face) {
      // The space between the vertex and the face must belong to the mesh: the midpoint must be
      // inside, too.
      const Vec3f between = x - face.normal * (0.5f * face.distance);
      if (face.distance > -kFarAway && point_to_mesh(between, onto, touch).distance <= touch)
        emit(vertex, side_of_normal(face.normal), x, face.normal, face.distance);
    };
    take(faces.over);
    for (const FacePoint& face : faces.beside) take(face);
  }
}

// Returns whether n, which is perpendicular to the edge, lies between the normals of the edge's two
// faces. For a border edge: whether n lies in front of its one face. For nearly parallel faces -n
// is excluded.
inline bool in_cone(const MeshView& mesh, const MeshEdge& edge, const Vec3f& n) {
  const Vec3f a = mesh.vertices[edge.a], along = mesh.vertices[edge.b] - a;
  const float square = math::dot(along, along);
  // Returns the direction in the face that points from the edge to the third corner.
  const auto beside = [&](int32_t corner) {
    const Vec3f d = mesh.vertices[corner] - a;
    return d - along * (math::dot(d, along) / square);
  };
  const auto below = [&](const Vec3f& d) {
    return math::dot(n, d) <= kStandSine * math::length(d);
  };
  if (!below(beside(edge.left))) return false;
  const bool before = math::dot(n, mesh.normals[edge.triangle]) >= -kBehindCosine;
  if (edge.right < 0) return before;
  const Vec3f right = beside(edge.right), normal = math::cross(right, along);
  return below(right) && (before || math::dot(n, normal) >= -kBehindCosine * math::length(normal));
}

// Calls emit(edge of A, edge of B, point on A, point on B, normal, distance) for each contact.
template <class Emit>
void edges_on_edges(const MeshView& a, const PlacedMesh& b, const MeshReach& reach, Emit emit) {
  const float touch = kMeshTouch * reach.size;
  const Vec3f grow = {reach.edges, reach.edges, reach.edges};
  const Transformf a_in_b = math::inverse(b.pose);
  for (int32_t j = 0; j < b.mesh->edge_count; ++j) {
    const MeshEdge& edge_b = b.mesh->edges[j];
    const Vec3f b0 = b.at(edge_b.a), b1 = b.at(edge_b.b), along_b = b1 - b0;
    const Box3 box = {
        Vec3f{math::min(b0.x, b1.x), math::min(b0.y, b1.y), math::min(b0.z, b1.z)} - grow,
        Vec3f{math::max(b0.x, b1.x), math::max(b0.y, b1.y), math::max(b0.z, b1.z)} + grow};
    for_triangles_in(a, box, [&](int32_t t) {
      const int32_t own[3] = {a.own_edges[t].x, a.own_edges[t].y, a.own_edges[t].z};
      for (int32_t k = 0; k < 3; ++k) {
        if (own[k] < 0) continue;
        const MeshEdge& edge_a = a.edges[own[k]];
        const Vec3f a0 = a.vertices[edge_a.a], along_a = a.vertices[edge_a.b] - a0;
        const Vec3f across = math::cross(along_a, along_b);
        const float square = math::dot(across, across);
        if (!(square > kCrossingSine * kCrossingSine * math::dot(along_a, along_a) *
                           math::dot(along_b, along_b)))
          continue;
        const float s = math::dot(math::cross(b0 - a0, along_b), across) / square;
        const float r = math::dot(math::cross(b0 - a0, along_a), across) / square;
        if (!(s >= 0.0f && s <= 1.0f && r >= 0.0f && r <= 1.0f)) continue;
        const Vec3f on_a = a0 + along_a * s, on_b = b0 + along_b * r;
        Vec3f n = across * (1.0f / math::sqrt(square));
        float distance = math::dot(on_b - on_a, n);
        const auto faces = [&](const Vec3f& normal) {
          return in_cone(a, edge_a, normal) &&
                 in_cone(*b.mesh, edge_b, -math::rotate_inverse(b.pose.q, normal));
        };
        if (distance < 0.0f) {
          n = -n;
          distance = -distance;
        }
        if (!(distance <= reach.edges)) continue;
        if (!faces(n)) {  // the edges are not separate, so test for an overlap
          n = -n;
          distance = -distance;
          const float in = touch - 0.1f * distance;
          if (!faces(n) || !(point_to_mesh(on_b, a, in).distance <= in) ||
              !(point_to_mesh(math::transform_point(a_in_b, on_a), *b.mesh, in).distance <= in))
            continue;
        }
        if (distance <= reach.gap) emit(own[k], j, on_a, on_b, n, distance);
      }
    });
  }
}

// Calls add(contact) for all contacts in a fixed order. Normals point from A to B.
template <class Add>
void collide_meshes(const MeshView& a, const MeshView& b, const Transformf& b_in_a,
                    const MeshReach& reach, Add add) {
  const Transformf a_in_b = math::inverse(b_in_a);
  vertices_on_mesh(a, {&b, b_in_a}, reach,
                   [&](int32_t vertex, int32_t side, const Vec3f& x, const Vec3f& n, float d) {
                     MeshContact contact;
                     contact.point = {x - n * (0.5f * d), d, side};
                     contact.normal = n;
                     contact.triangle = vertex;
                     add(contact);
                   });
  vertices_on_mesh(
      b, {&a, a_in_b}, reach,
      [&](int32_t vertex, int32_t side, const Vec3f& x, const Vec3f& n, float d) {
        MeshContact contact;
        contact.point = {math::transform_point(b_in_a, x - n * (0.5f * d)), d, kVertexKinds + side};
        contact.normal = -math::rotate(b_in_a.q, n);
        contact.triangle = vertex;
        add(contact);
      });
  edges_on_edges(a, {&b, b_in_a}, reach,
                 [&](int32_t edge_a, int32_t edge_b, const Vec3f& on_a, const Vec3f& on_b,
                     const Vec3f& n, float d) {
                   MeshContact contact;
                   contact.point = {(on_a + on_b) * 0.5f, d, kEdgeFeature + edge_b};
                   contact.normal = n;
                   contact.triangle = edge_a;
                   add(contact);
                 });
}

// Drops an overlap if another contact nearby has a smaller overlap in another direction. A contact
// of edges is dropped for any smaller overlap. A contact of a vertex is dropped only if the other
// overlap is much smaller. Otherwise a vertex that is flush with one side would be pushed through
// the mesh to the far side. Moves the remaining contacts to the front, in their order, and returns
// their number.
inline int32_t drop_long_ways(MeshContact* c, int32_t count) {
  const auto is_long = [&](const MeshContact& contact) {
    const float distance = contact.point.distance;
    if (!(distance < 0.0f)) return false;
    const bool of_edges = contact.point.feature >= kEdgeFeature;
    const float times = of_edges ? kAsDeep : kFarDeeper, near = of_edges ? -kLongWay : -1.0f;
    for (int32_t i = 0; i < count; ++i) {
      const MeshContact& other = c[i];
      if (other.point.distance <= 0.0f && times * other.point.distance > distance &&
          math::dot(other.normal, contact.normal) < kGroupCosine &&
          math::length(other.point.position - contact.point.position) <= near * distance &&
          (of_edges || other.triangle != contact.triangle ||
           other.point.feature / kVertexKinds != contact.point.feature / kVertexKinds))
        return true;
    }
    return false;
  };
  for (int32_t i = 0; i < count; ++i) c[i].kept = !is_long(c[i]);
  int32_t n = 0;
  for (int32_t i = 0; i < count; ++i)
    if (c[i].kept) c[n++] = c[i];
  return n;
}

}  // namespace novaphy::geometry
