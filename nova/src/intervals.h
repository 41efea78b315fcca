// Internal: stretches of memory, and maps of disjoint ones by their begin.
#pragma once

#include <cstdint>
#include <iterator>

#include "novaphy/nova/op_list.h"

namespace nova::detail {

inline bool share_bytes(const MemoryAccess& a, const MemoryAccess& b) {
  return a.begin < b.begin + b.bytes && b.begin < a.begin + a.bytes;
}

// The first interval that ends behind `begin`. What the map holds has an `end`.
auto first_from(auto& intervals, uint64_t begin) {
  auto at = intervals.upper_bound(begin);
  if (at != intervals.begin() && std::prev(at)->second.end > begin) --at;
  return at;
}

}  // namespace nova::detail
