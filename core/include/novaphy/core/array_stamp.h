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
    const std::shared_ptr<Range>& range = array.range();
    // The storage that owns the range is compared without a count of its owners.
    return at_ != nullptr && at_ == range.get() && !storage_.owner_before(range) &&
           !range.owner_before(storage_) && version_ == array.version() &&
           exports_ == range->exports() && !range->writable_export();
  }
  void set(const Array& array) {
    reset();
    if (!array.range() || array.range()->writable_export()) return;
    at_ = array.range().get();
    storage_ = array.range();
    version_ = array.version();
    exports_ = array.range()->exports();
  }
  void reset() {
    at_ = nullptr;
    storage_.reset();
  }

 private:
  const Range* at_ = nullptr;
  std::weak_ptr<Range> storage_;  // so that no other has its address
  uint64_t version_ = 0, exports_ = 0;
};

}  // namespace novaphy
