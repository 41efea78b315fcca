// Internal: the versions of the model arrays from which a result was computed.
#pragma once

#include <array>
#include <cstdint>

#include "novaphy/core/device_array.h"

namespace novaphy::detail {

template <size_t N>
class ArrayVersions {
 public:
  using Arrays = std::array<const Array*, N>;

  // Returns whether the arrays are unchanged. The result is false if an array was ever exported,
  // because an exported array can change without a new version.
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
