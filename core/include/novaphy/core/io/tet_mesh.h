// Tetrahedral meshes from files, for ModelBuilder::add_soft_mesh.
//
// The format is Gmsh's MSH 4.1, ASCII (https://gmsh.info/doc/texinfo/gmsh.html, "MSH file format"),
// which Gmsh writes by default and most meshers can write. The reader needs no library.
#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include "novaphy/core/export.h"
#include "novaphy/math/types.h"

namespace novaphy {

struct TetMesh {
  std::vector<Vec3f> vertices;   // in the order of the file; its unit and axes, rounded to float32
  std::vector<int32_t> indices;  // 4 per tetrahedron, into vertices, of positive volume
};

struct TetMeshOptions {
  // Meshers write nodes of the geometry that no tetrahedron uses, the center of a circle for one.
  // Such a node has no mass: it is refused, or with this left out (the order of the others stays).
  bool drop_loose_vertices = false;
};

// Reads the 4-node tetrahedra of all blocks. Points, lines and surfaces in the file are its
// boundary and are skipped, as are physical groups and all other sections.
//
// ErrorKind::Value, naming the path and, where there is one, the line: a file that is missing or
// cannot be read; another format or version, or a binary file; a section that is missing or broken;
// a position that is not finite; an element of an unknown node; solid elements that are no 4-node
// tetrahedra; no tetrahedron at all; a degenerate tetrahedron (volume up to 1e-7 of the longest
// edge cubed) or an inverted one, with how many there are; a face of more than two tetrahedra, or
// of two on the same side; a loose vertex.
NOVAPHY_CORE_API TetMesh load_tet_mesh(const std::filesystem::path& path,
                                       const TetMeshOptions& options = {});

}  // namespace novaphy
