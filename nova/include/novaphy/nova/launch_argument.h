// Tensors and parts of memory as arguments of a launch (core/device_kernel.h).
#pragma once

#include "novaphy/core/device_kernel.h"
#include "novaphy/nova/tensor.h"

namespace nova {

// Returns a tensor as an argument. An undefined tensor gives a null pointer.
inline novaphy::Untyped argument(const Tensor& tensor) {
  return tensor.defined() ? novaphy::Untyped(tensor.range()) : novaphy::Untyped(nullptr);
}

// Returns `bytes` bytes of a range from byte `first` on as an argument. 0 bytes give a null
// pointer.
inline novaphy::Untyped part_of(const std::shared_ptr<novaphy::Range>& all, size_t first,
                                size_t bytes) {
  if (bytes == 0) return novaphy::Untyped(nullptr);
  return novaphy::Untyped(all->storage().range(all->offset() + first, bytes));
}

}  // namespace nova
