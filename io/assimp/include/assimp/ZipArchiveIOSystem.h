// Replaces assimp's reader of ZIP archives, so that the build needs no zlib. load_mesh reads .dae
// files, which are never archives, and does not read .zae files.
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
