// Compiled device code on disk, shared by all processes of a user.
//
// Each entry is a file named by its key. A file is written under another name and then renamed, so
// that a reader sees a whole file or none. A file contains its key, its length and a checksum. A
// file with a mismatch is removed and built again. If the folder exceeds its limit, the oldest
// entries are removed.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "compiler.h"

namespace novaphy::gpu {

struct CodeKey {
  uint64_t a = 0, b = 0;
  bool operator==(const CodeKey&) const = default;
};
CodeKey code_key(const std::string& text);
// ahead_key hashes the text and the options. disk_key also hashes the device and the compiler's
// version.
CodeKey ahead_key(const std::string& source, Dialect dialect);
CodeKey disk_key(const std::string& source, Dialect dialect, int arch);

class CodeCache {
 public:
  // The folder is NOVAPHY_CACHE_DIR ("off" for no cache), or XDG_CACHE_HOME/novaphy, or
  // ~/.cache/novaphy. NOVAPHY_CACHE_MB limits its size.
  static CodeCache& get();
  CodeCache(std::string folder, uint64_t limit_bytes);

  bool find(const CodeKey& key, std::vector<char>& code);
  // A cache that cannot be written is not an error: the next process compiles again.
  void store(const CodeKey& key, const std::vector<char>& code);
  const std::string& folder() const { return folder_; }

 private:
  std::string path_of(const CodeKey& key) const;
  void make_room();
  std::string folder_;  // empty: no cache
  uint64_t limit_;
};

}  // namespace novaphy::gpu
