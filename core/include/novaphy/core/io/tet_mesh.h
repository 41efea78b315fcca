// Tetrahedral meshes from files, for ModelBuilder::add_soft_mesh.
//
// The format is Gmsh's MSH 4.1, ASCII (https://gmsh.info/doc/texinfo/gmsh.html, "MSH file format").
// Gmsh writes this format by default, and most meshers can write it. The reader needs no library.
#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include "novaphy/core/export.h"
#include "novaphy/math/types.h"

namespace novaphy {

struct TetMesh {
  std::vector<Vec3f> vertices;   // in the order, units and axes of the file, rounded to float32
  std::vector<int32_t> indices;  // 4 per tetrahedron, into vertices; every volume is positive
};

struct TetMeshOptions {
  // Whether the reader drops nodes that no tetrahedron uses, and keeps the order of the others. If
  // false, such nodes are an error, because a particle without a tetrahedron has no mass. Meshers
  // write them, for example, for the center of a circle.
  bool drop_loose_vertices = false;
};

// Reads the 4-node tetrahedra of all blocks. Points, lines and surfaces of the file describe its
// boundary and are skipped, as are physical groups and all other sections.
//
// Throws ErrorKind::Value with the path, and with the line where one is known:
//   the file is missing or cannot be read
//   the file is not in MSH format, not of version 4.1, or binary
//   a section is missing or broken
//   a position is not finite, or an element names an unknown node
//   a solid element is not a 4-node tetrahedron, or the file has no tetrahedron
//   a tetrahedron is degenerate (volume up to 1e-7 of the longest edge cubed) or inverted; the
//     message has the number of such tetrahedra
//   a face belongs to more than two tetrahedra, or to two on the same side
//   a vertex belongs to no tetrahedron (see drop_loose_vertices)
NOVAPHY_CORE_API TetMesh load_tet_mesh(const std::filesystem::path& path,
                                       const TetMeshOptions& options = {});

}  // namespace novaphy
