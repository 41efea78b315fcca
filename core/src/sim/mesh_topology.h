// Topology from the index lists of meshes: the surface of tetrahedra, the edges of triangles.
#pragma once

#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "novaphy/math/types.h"

namespace novaphy::detail {

// The faces that one tetrahedron has and no other, in the order in which they come: each
// tetrahedron (i, j, k, l) has the faces (i, k, j), (j, k, l), (i, j, l), (i, l, k), which look
// outwards. ErrorKind::Value, naming `function` and the face: more than two tetrahedra share one.
std::vector<Vec3i> surface_of(std::span<const Vec4i> tetrahedra, std::string_view function);

// Every edge once, in the order in which they come: each triangle (a, b, c) has the edges (a, b),
// (b, c), (c, a). As rows of edge_indices: the vertices opposite to the edge in its first and
// second triangle (-1: none), then the edge as its first triangle has it. ErrorKind::Value, naming
// `function` and the edge: more than two triangles share one; `advice` ends the message.
std::vector<Vec4i> edges_of(std::span<const Vec3i> triangles, std::string_view function,
                            std::string_view advice);

// Pairs (a < b) along the edges, from the opposite vertices to their ends, and across the edges:
// every pair once, in the order in which they come.
std::vector<Vec2i> spring_pairs(std::span<const Vec4i> edges);

}  // namespace novaphy::detail
