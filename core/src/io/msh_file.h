// Reader of Gmsh's MSH 4.1 ASCII format: the nodes and the 4-node tetrahedra, unchanged.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "novaphy/math/types.h"
#include "words.h"

namespace novaphy::detail {

struct MshFile {
  struct Tetrahedron {
    int64_t tag;
    size_t line;
    std::array<int32_t, 4> nodes;  // rows of `positions`
  };
  std::vector<Vec3f> positions;  // finite
  std::vector<int64_t> node_tags;
  std::vector<Tetrahedron> tetrahedra;
};

// Reads a file. Throws the errors of load_tet_mesh about the format and unknown nodes. The shape of
// the mesh is not checked.
MshFile read_msh(Words& words);

}  // namespace novaphy::detail
