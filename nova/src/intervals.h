// Internal: intervals of memory, and maps of disjoint intervals keyed by their start.
#pragma once

#include <cstdint>
#include <iterator>

#include "novaphy/nova/op_list.h"

namespace nova::detail {

inline bool share_bytes(const MemoryAccess& a, const MemoryAccess& b) {
  return a.begin < b.begin + b.bytes && b.begin < a.begin + a.bytes;
}

// Returns the first interval that ends after `begin`. The values of the map have a member `end`.
auto first_from(auto& intervals, uint64_t begin) {
  auto at = intervals.upper_bound(begin);
  if (at != intervals.begin() && std::prev(at)->second.end > begin) --at;
  return at;
}

}  // namespace nova::detail
