// A tensor as an argument of a launch (core/device_kernel.h).
#pragma once

#include "novaphy/core/device_kernel.h"
#include "novaphy/nova/tensor.h"

namespace nova {

// An undefined tensor: a null pointer.
inline novaphy::Untyped argument(const Tensor& tensor) {
  return tensor.defined() ? novaphy::Untyped(tensor.range()) : novaphy::Untyped(nullptr);
}
inline novaphy::LaunchArgument argument(const char* name, const Tensor& tensor, bool write) {
  novaphy::LaunchArgument made;
  if (!tensor.defined()) return made;
  made.word = reinterpret_cast<uint64_t>(tensor.range()->data());
  made.name = name;
  made.range = tensor.range();
  made.read = true;
  made.write = write;
  return made;
}

}  // namespace nova
