// Remembers which bytes, in which version, something was made from.
#pragma once

#include <cstdint>
#include <memory>

#include "novaphy/core/device_array.h"

namespace novaphy {

class ArrayStamp {
 public:
  // True if the array is the one that was stamped and was not written since. False for an array
  // that is exported writable, or was meanwhile: it can change unseen.
  bool matches(const Array& array) const {
    const std::shared_ptr<Range> range = range_.lock();
    return range != nullptr && range == array.range() && version_ == array.version() &&
           exports_ == range->exports() && !range->writable_export();
  }
  void set(const Array& array) {
    range_.reset();
    if (!array.range() || array.range()->writable_export()) return;
    range_ = array.range();
    version_ = array.version();
    exports_ = array.range()->exports();
  }
  void reset() { range_.reset(); }

 private:
  std::weak_ptr<Range> range_;
  uint64_t version_ = 0, exports_ = 0;
};

}  // namespace novaphy
