// Device code compiled in the build and stored in the plugin.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "code_cache.h"

namespace novaphy::gpu {

struct AheadEntry {
  CodeKey key;  // ahead_key
  int32_t arch = 0;
  int32_t is_text = 0;  // whether the code is assembler text for this and newer devices, or else an
                        // image for this device and newer ones of the same major version
  uint64_t offset = 0;  // offset of the code in the whole data; 64-byte aligned
  uint64_t bytes = 0;
};
struct AheadHeader {
  char magic[8];
  uint64_t count;  // number of entries that follow, sorted by key, then images before texts, then
                   // by arch
};
inline constexpr char kAheadMagic[8] = {'N', 'V', 'P', 'H', 'D', 'E', 'V', '1'};

struct AheadCode {
  const void* data = nullptr;
  uint64_t bytes = 0;
};
// Returns the newest image that runs on the device, or else the newest text, or else null.
AheadCode find_ahead(const CodeKey& key, int arch);

// The data that the plugin defines. No bytes mean that nothing was compiled ahead of time.
struct AheadData {
  const unsigned char* data;
  uint64_t bytes;
};
AheadData ahead_data();

}  // namespace novaphy::gpu
