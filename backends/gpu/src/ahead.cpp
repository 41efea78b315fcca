#include "ahead.h"

#include <algorithm>
#include <cstring>
#include <tuple>

namespace novaphy::gpu {

AheadCode find_ahead(const CodeKey& key, int arch) {
  const AheadData all = ahead_data();
  if (all.bytes < sizeof(AheadHeader)) return {};
  AheadHeader header;
  std::memcpy(&header, all.data, sizeof(header));
  if (std::memcmp(header.magic, kAheadMagic, sizeof(kAheadMagic)) != 0) return {};
  const auto* const entries = reinterpret_cast<const AheadEntry*>(all.data + sizeof(header));
  const auto* const last = entries + header.count;
  const auto* const first =
      std::lower_bound(entries, last, key, [](const AheadEntry& entry, const CodeKey& k) {
        return std::tie(entry.key.a, entry.key.b) < std::tie(k.a, k.b);
      });
  const AheadEntry* best = nullptr;
  for (const AheadEntry* entry = first; entry != last && entry->key == key; ++entry) {
    // An image runs on devices of the same major version that are not older.
    const bool fits = entry->arch <= arch && (entry->is_text != 0 || entry->arch / 10 == arch / 10);
    if (!fits || (best != nullptr && best->is_text < entry->is_text)) continue;
    best = entry;
  }
  return best != nullptr ? AheadCode{all.data + best->offset, best->bytes} : AheadCode{};
}

}  // namespace novaphy::gpu
