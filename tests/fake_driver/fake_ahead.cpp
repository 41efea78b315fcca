// What a plugin that was built with NOVA_ENABLE_NVRTC=OFF has ahead: the builtins, the interpreter
// and the hand-written kernels. Their code is nothing here; the fake driver knows kernels by their
// names.
#include <algorithm>
#include <cstring>
#include <vector>

#include "ahead.h"
#include "device_source.h"

namespace novaphy::detail {
const char* soft_contact_kernels_text();
#ifdef FAKE_DRIVER_HAS_VBD
const char* vbd_kernels_text();
#endif
}  // namespace novaphy::detail

namespace novaphy::gpu {

AheadData ahead_data() {
  static const std::vector<unsigned char> bytes = [] {
    std::vector<AheadEntry> entries(3);
    entries[0].key = ahead_key(builtins_source(), Dialect::Program);
    entries[1].key = ahead_key(interpreter_source(), Dialect::Program);
    entries[2].key = ahead_key(module_source(detail::soft_contact_kernels_text()), Dialect::Source);
#ifdef FAKE_DRIVER_HAS_VBD
    entries.emplace_back().key =
        ahead_key(module_source(detail::vbd_kernels_text()), Dialect::Source);
#endif
    const size_t entry_bytes = entries.size() * sizeof(AheadEntry);
    std::sort(std::begin(entries), std::end(entries),
              [](const AheadEntry& x, const AheadEntry& y) { return x.key.a < y.key.a; });
    AheadHeader header{};
    std::memcpy(header.magic, kAheadMagic, sizeof(header.magic));
    header.count = std::size(entries);
    std::vector<unsigned char> all(sizeof(header) + entry_bytes + 1);
    for (AheadEntry& entry : entries) {
      entry.arch = 90;
      entry.offset = sizeof(header) + entry_bytes;
      entry.bytes = 1;
    }
    std::memcpy(all.data(), &header, sizeof(header));
    std::memcpy(all.data() + sizeof(header), entries.data(), entry_bytes);
    return all;
  }();
  return {bytes.data(), bytes.size()};
}

}  // namespace novaphy::gpu
