// The check of the corners of elements, for the CPU solver and before kernels run. A kernel reads
// zeros at an index that is out of range, so it cannot report the error.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>

#include "novaphy/core/error.h"

namespace novaphy {

// Throws ErrorKind::Index, with the model's array and the entry, if a particle does not exist. -1
// is allowed if `may_be_absent`.
inline void check_corners(std::span<const int32_t> entries, int32_t particle_count,
                          std::string_view name, bool may_be_absent) {
  for (size_t k = 0; k < entries.size(); ++k) {
    const bool there = entries[k] >= 0 && entries[k] < particle_count;
    require(there || (may_be_absent && entries[k] == -1), ErrorKind::Index, "model.", name,
            ": entry ", k, ": expected a particle from 0 to ", particle_count - 1,
            may_be_absent ? ", or -1" : "", ", got ", entries[k]);
  }
}

}  // namespace novaphy
