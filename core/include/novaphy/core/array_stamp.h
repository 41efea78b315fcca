// ArrayStamp: remembers the memory range and the version of an array that a result was computed
// from.
#pragma once

#include <cstdint>
#include <memory>

#include "novaphy/core/device_array.h"

namespace novaphy {

class ArrayStamp {
 public:
  // Returns whether `array` is the stamped array and nothing has written to it since the stamp. An
  // array with a writable export, now or at any time since the stamp, gives false: another library
  // can change such an array without a new version.
  bool matches(const Array& array) const {
    const std::shared_ptr<Range>& range = array.range();
    // owner_before compares the owners of two pointers and changes no reference count.
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
  std::weak_ptr<Range> storage_;  // weak, but keeps the address from being reused
  uint64_t version_ = 0, exports_ = 0;
};

}  // namespace novaphy
