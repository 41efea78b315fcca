// Internal: the versions of arrays of a model that something was made from.
#pragma once

#include <array>
#include <cstdint>

#include "novaphy/core/device_array.h"

namespace novaphy::detail {

template <size_t N>
class ArrayVersions {
 public:
  using Arrays = std::array<const Array*, N>;

  // Whether the arrays are as they were when they were set. False for one that was ever exported:
  // it can change unseen.
  bool match(const Arrays& arrays) const {
    for (size_t k = 0; k < N; ++k) {
      const auto& range = arrays[k]->range();
      if (versions_[k] != arrays[k]->version() || (range && range->was_exported())) return false;
    }
    return known_;
  }
  void set(const Arrays& arrays) {
    for (size_t k = 0; k < N; ++k) versions_[k] = arrays[k]->version();
    known_ = true;
  }
  void reset() { known_ = false; }

 private:
  bool known_ = false;
  std::array<uint64_t, N> versions_{};
};

}  // namespace novaphy::detail
