// Internal: memory for rows of a struct that is not an element type of arrays. Kernels take this
// memory as arguments of the type Untyped.
#pragma once

#include "novaphy/core/device_array.h"

namespace novaphy::detail {

template <class T>
Array byte_array(size_t rows, Device device) {
  const auto storage = Storage::allocate(rows * sizeof(T), device);
  return {DType::uint8, storage->bytes(), 1, storage->range()};
}

}  // namespace novaphy::detail
