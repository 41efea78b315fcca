// Topology from the index lists of meshes: the surface of tetrahedra, the edges of triangles.
#pragma once

#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "novaphy/math/types.h"

namespace novaphy::detail {

// Returns the faces that belong to exactly one tetrahedron, in the order of the tetrahedra. A
// tetrahedron (i, j, k, l) has the outward faces (i, k, j), (j, k, l), (i, j, l) and (i, l, k).
// ErrorKind::Value, with `function` and the face: more than two tetrahedra share a face.
std::vector<Vec3i> surface_of(std::span<const Vec4i> tetrahedra, std::string_view function);

// Returns every edge of a triangle mesh once, in the order of the triangles. A triangle (a, b, c)
// has the edges (a, b), (b, c) and (c, a). The result is in the form of edge_indices: the vertices
// opposite to the edge in its first and second triangle (-1: none), then the edge as in its first
// triangle. ErrorKind::Value, with `function` and the edge: more than two triangles share an edge.
// `advice` ends the message.
std::vector<Vec4i> edges_of(std::span<const Vec3i> triangles, std::string_view function,
                            std::string_view advice);

// Returns pairs (a < b) of particles for springs: along the edges, from the opposite vertices to
// the ends of an edge, and between the opposite vertices. Every pair occurs once, in the order of
// the edges.
std::vector<Vec2i> spring_pairs(std::span<const Vec4i> edges);

}  // namespace novaphy::detail
