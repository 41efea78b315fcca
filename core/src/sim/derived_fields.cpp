#include "novaphy/core/sim/derived_fields.h"

namespace novaphy {

bool DerivedStamp::matches(const Array& source) const {
  const Range* range = source.range().get();
  if (range == nullptr) return true;  // no rows
  if (range_.load(std::memory_order_acquire) != range ||
      version_.load(std::memory_order_acquire) != range->version())
    return false;
  if (!range->writable_export()) return true;
  return range->checksum() == (has_checksum_ ? checksum_.load() : range->exported_checksum());
}

void DerivedStamp::set(const Array& source) {
  const Range* range = source.range().get();
  if (range == nullptr) return;
  has_checksum_ = range->writable_export();
  checksum_ = has_checksum_ ? range->checksum() : 0;
  version_.store(range->version(), std::memory_order_release);
  range_.store(range, std::memory_order_release);
}

}  // namespace novaphy
