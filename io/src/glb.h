// Reads binary glTF files (.glb) into triangles that share no vertices.
#pragma once

#include "assimp_scene.h"

namespace novaphy::detail {

// Returns all triangles of the scene in a file's `bytes`, placed by its nodes. Numbers are
// unchanged, which means meters with y up by the format's definition. Every error message begins
// with `where`. ErrorKind::Value: the file is truncated or inconsistent. ErrorKind::NotImplemented:
// data outside of the file, compressed or sparse data, primitives other than triangles.
Soup read_glb(const std::string& where, std::string_view bytes);

}  // namespace novaphy::detail
