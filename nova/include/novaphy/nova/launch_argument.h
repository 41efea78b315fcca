// A tensor, or a part of memory, as an argument of a launch (core/device_kernel.h).
#pragma once

#include "novaphy/core/device_kernel.h"
#include "novaphy/nova/tensor.h"

namespace nova {

// An undefined tensor: a null pointer.
inline novaphy::Untyped argument(const Tensor& tensor) {
  return tensor.defined() ? novaphy::Untyped(tensor.range()) : novaphy::Untyped(nullptr);
}

// Bytes of a range, from its byte `first` on; none: a null pointer.
inline novaphy::Untyped part_of(const std::shared_ptr<novaphy::Range>& all, size_t first,
                                size_t bytes) {
  if (bytes == 0) return novaphy::Untyped(nullptr);
  return novaphy::Untyped(all->storage().range(all->offset() + first, bytes));
}

}  // namespace nova
