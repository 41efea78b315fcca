// What a plugin that was built with NOVA_ENABLE_NVRTC=OFF has ahead: the builtins and the
// interpreter. Their code is nothing here; the fake driver knows kernels by their names.
#include <algorithm>
#include <cstring>
#include <vector>

#include "ahead.h"
#include "device_source.h"

namespace novaphy::gpu {

AheadData ahead_data() {
  static const std::vector<unsigned char> bytes = [] {
    AheadEntry entries[2];
    entries[0].key = ahead_key(builtins_source(), Dialect::Program);
    entries[1].key = ahead_key(interpreter_source(), Dialect::Program);
    if (entries[1].key.a < entries[0].key.a) std::swap(entries[0], entries[1]);
    AheadHeader header{};
    std::memcpy(header.magic, kAheadMagic, sizeof(header.magic));
    header.count = 2;
    std::vector<unsigned char> all(sizeof(header) + sizeof(entries) + 1);
    for (AheadEntry& entry : entries) {
      entry.arch = 90;
      entry.offset = sizeof(header) + sizeof(entries);
      entry.bytes = 1;
    }
    std::memcpy(all.data(), &header, sizeof(header));
    std::memcpy(all.data() + sizeof(header), entries, sizeof(entries));
    return all;
  }();
  return {bytes.data(), bytes.size()};
}

}  // namespace novaphy::gpu
