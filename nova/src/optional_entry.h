// Internal: optional functions of a backend.
#pragma once

#include <cstdint>

#include "novaphy/abi/backend.h"

namespace nova::detail {

// Returns whether a backend's table has an optional entry. The table of an older backend is
// shorter.
template <class Entry>
bool has_entry(const novaphy_backend_api& api, Entry novaphy_backend_api::*entry) {
  const auto begin = reinterpret_cast<uintptr_t>(&api);
  const auto end = reinterpret_cast<uintptr_t>(&(api.*entry)) + sizeof(Entry);
  return api.struct_size >= end - begin && api.*entry != nullptr;
}

}  // namespace nova::detail
