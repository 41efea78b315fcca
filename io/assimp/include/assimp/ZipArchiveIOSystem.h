// Instead of assimp's reader of ZIP archives: a COLLADA file is never one here, because load_mesh
// takes .dae and no .zae. So there is no zlib either.
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
