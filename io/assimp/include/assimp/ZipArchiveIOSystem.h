// Replaces assimp's reader of ZIP archives, so that the build needs no zlib. A .dae file is never
// an archive, and load_mesh does not read .zae archives.
#pragma once

#include <assimp/IOSystem.hpp>
#include <string>
#include <vector>

namespace Assimp {

class ZipArchiveIOSystem {
 public:
  ZipArchiveIOSystem(IOSystem*, const std::string&) {}
  bool isOpen() const { return false; }
  IOStream* Open(const char*) { return nullptr; }
  void getFileListExtension(std::vector<std::string>&, const std::string&) const {}
};

}  // namespace Assimp
