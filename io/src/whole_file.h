// Checks that a file is complete before assimp reads it.
//
// assimp does not notice four faults. On a short PLY file assimp reads past the end. On a PLY
// without the end of its header, and on a COLLADA with non-numbers among its indices, assimp never
// ends. An STL text that was cut becomes a smaller mesh. (An OBJ does not say how much belongs to
// it; a COLLADA that was cut is no XML.)
#pragma once

#include <string>
#include <string_view>

namespace novaphy::detail {

// `bytes`: the file. ErrorKind::Value, its message beginning with `where`.
void check_whole(const std::string& where, std::string_view extension, std::string_view bytes);

// The lines of an OBJ file from which triangles come, written so that assimp counts all numbers: it
// passes over a vertex with a number that begins with a point, and over a line that begins with a
// blank. ErrorKind::Value: a vertex that is not x y z, with w, r g b or r g b a behind.
std::string obj_for_assimp(const std::string& where, std::string_view bytes);

}  // namespace novaphy::detail
