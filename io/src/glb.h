// Binary glTF files (.glb), as a soup of triangles.
#pragma once

#include "assimp_scene.h"

namespace novaphy::detail {

// All triangles of the scene in the `bytes` of a file, placed by its nodes; numbers as in the file,
// meters with y up by its definition. `where` begins every message. ErrorKind::Value: a file that
// is cut or contradicts itself; ErrorKind::NotImplemented: data outside of the file, compressed or
// sparse data, primitives other than triangles.
Soup read_glb(const std::string& where, std::string_view bytes);

}  // namespace novaphy::detail
