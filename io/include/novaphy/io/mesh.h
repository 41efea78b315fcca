// Triangle meshes from files, for ModelBuilder::add_cloth_mesh.
//
// The formats are Wavefront OBJ, STL (text and binary), PLY (text and binary) and COLLADA, read by
// assimp. Tetrahedral meshes need no library: novaphy/core/io/tet_mesh.h.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <vector>

#include "novaphy/io/export.h"
#include "novaphy/math/types.h"

namespace novaphy {

struct Mesh {
  std::vector<Vec3f> vertices;      // see load_mesh for unit and axes
  std::vector<int32_t> indices;     // 3 per triangle, into vertices, counter-clockwise from outside
  std::optional<Vec3f> color = {};  // of the material of most of the surface; none of an image
  // Of each triangle; empty: they have one, or none.
  std::vector<std::optional<Vec3f>> colors = {};
};

// A mesh of each color, in the order in which the triangles have them first.
NOVAPHY_IO_API std::vector<Mesh> parts_by_color(const Mesh& mesh);

struct MeshOptions {
  // Corners at the same position, to the bit, become one vertex. Most formats store the corners of
  // every triangle, so without this a mesh falls apart into triangles. It also joins what only
  // touches: parts that share positions.
  bool join_vertices = true;
  // Leaves out triangles with two corners at the same position, which otherwise are an error.
  bool drop_degenerate = false;
};

// Everything in the file as one mesh: all meshes of its scene, each where the nodes of the scene
// put it (a mesh that is used twice comes twice; a mirroring node keeps the outside outside).
//
// * The format is the ending of the name: .obj, .stl, .ply, .dae or .glb, in any case.
// * Polygons are cut into triangles. Points and lines are left out, and so are vertices that no
//   triangle uses: of most formats assimp does not even say that they were there.
// * Unit and axes: .dae says both, and comes in meters with z up. The others say nothing, and their
//   numbers stay as they are; `scale` and `rot` of add_cloth_mesh do the rest.
// * Vertices come in the order in which the triangles use them first.
// * The materials of an .obj are in a file beside it; without one the mesh has no color.
// * Numbers in text are rounded as assimp does, which may be the last bit of a float32 off.
//
// ErrorKind::Value, naming the path: another ending; a file that is missing or cannot be read; one
// that is broken, with what assimp says of it (an index out of range for one); no triangle at all;
// a position that is not finite; a triangle with two corners in one place.
NOVAPHY_IO_API Mesh load_mesh(const std::filesystem::path& path, const MeshOptions& options = {});

}  // namespace novaphy
