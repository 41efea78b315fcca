// Compiled device code on disk, shared by all processes of a user.
//
// One file per entry, named by its key. A file is written under another name and renamed, so that a
// reader sees a whole file or none. A file carries its key, its length and a checksum. A file that
// does not fit is removed and made anew. The oldest entries go when the folder grows past its
// limit.
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
// Of code that was built ahead: of the text and the options. Of code on disk: also of the device
// and the compiler's version.
CodeKey ahead_key(const std::string& source, Dialect dialect);
CodeKey disk_key(const std::string& source, Dialect dialect, int arch);

class CodeCache {
 public:
  // NOVAPHY_CACHE_DIR ("off": no cache), else XDG_CACHE_HOME/novaphy, else ~/.cache/novaphy;
  // limited to NOVAPHY_CACHE_MB.
  static CodeCache& get();
  CodeCache(std::string folder, uint64_t limit_bytes);

  bool find(const CodeKey& key, std::vector<char>& code);
  // A cache that cannot be written is no error: the next process compiles again.
  void store(const CodeKey& key, const std::vector<char>& code);
  const std::string& folder() const { return folder_; }

 private:
  std::string path_of(const CodeKey& key) const;
  void make_room();
  std::string folder_;  // empty: no cache
  uint64_t limit_;
};

}  // namespace novaphy::gpu
