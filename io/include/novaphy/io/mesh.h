// Triangle meshes from files, for ModelBuilder::add_cloth_mesh.
//
// Supported formats: Wavefront OBJ, STL (text and binary), PLY (text and binary), COLLADA and
// binary glTF. The library assimp reads all formats except binary glTF. Tetrahedral meshes have
// their own reader, which needs no library (novaphy/core/io/tet_mesh.h).
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <vector>

#include "novaphy/io/export.h"
#include "novaphy/math/types.h"

namespace novaphy {

struct Mesh {
  std::vector<Vec3f> vertices;      // load_mesh describes units and axes
  std::vector<int32_t> indices;     // 3 per triangle, into vertices, counter-clockwise from outside
  std::optional<Vec3f> color = {};  // material color of most of the surface; empty if it has an
                                    // image
  // Color of each triangle. If empty, all triangles have the color `color`, or none has a color.
  std::vector<std::optional<Vec3f>> colors = {};
};

// Splits a mesh into parts by the colors of its triangles. Parts have the order in which their
// colors first occur.
NOVAPHY_IO_API std::vector<Mesh> parts_by_color(const Mesh& mesh);

struct MeshOptions {
  // Whether corners with exactly the same position are merged into one vertex. Most formats store
  // the corners of every triangle separately, so that an unmerged mesh falls apart into triangles.
  // Merging also connects parts that only touch.
  bool join_vertices = true;
  // Whether triangles with two corners at the same position are left out. If false, they are an
  // error.
  bool drop_degenerate = false;
};

// Reads a file as one mesh: all meshes of its scene, placed by the scene's nodes. A mesh that is
// used twice occurs twice. Triangles of a mirrored node still face outward.
//
// * The extension gives the format: .obj, .stl, .ply, .dae or .glb, in upper or lower case.
// * Polygons are cut into triangles. Points, lines and vertices without a triangle are left out.
// * Units and axes: .dae defines both and is converted to meters with z up. The numbers of other
//   formats stay unchanged; use `scale` and `rot` of add_cloth_mesh.
// * Vertices have the order of their first use by a triangle.
// * An .obj takes its materials from a file in the same folder. Without this file the mesh has no
//   color.
// * Numbers in text are rounded by assimp, which may change the last bit of a float32.
//
// Throws ErrorKind::Value with the path: an unknown extension; a file that is missing or
// unreadable; a corrupt file, with assimp's message; no triangle; a position that is not finite; a
// triangle with two corners at the same position.
NOVAPHY_IO_API Mesh load_mesh(const std::filesystem::path& path, const MeshOptions& options = {});

}  // namespace novaphy
