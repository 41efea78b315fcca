// Checks that a file is complete before assimp reads it.
//
// assimp does not detect some faults. A truncated PLY file is read past its end. A PLY file without
// the end of its header, or a COLLADA file with text among its indices, makes assimp run forever. A
// truncated STL text is read as a smaller mesh. OBJ files have no length to check, and a truncated
// COLLADA file is not XML.
#pragma once

#include <string>
#include <string_view>

namespace novaphy::detail {

// Checks the contents `bytes` of a file. Throws ErrorKind::Value with a message that begins with
// `where`.
void check_whole(const std::string& where, std::string_view extension, std::string_view bytes);

// Returns the lines of an OBJ file that define triangles, in a form that assimp reads completely:
// assimp itself skips a vertex with a number that begins with a point, and a line that begins with
// a blank. ErrorKind::Value: a vertex that is not x y z, optionally followed by w, r g b or r g b
// a.
std::string obj_for_assimp(const std::string& where, std::string_view bytes);

}  // namespace novaphy::detail
