// Internal: checks of arguments. Messages are only composed on failure.
#pragma once

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstdint>
#include <span>
#include <string>

#include "novaphy/core/error.h"
#include "novaphy/nova/tensor.h"

namespace nova::detail {

// The beginning of an error message: "adam_update_f32, m: ", or "Adam, params[2]: " for an element
// of a list.
struct Argument {
  const char* call;
  const char* name;
  int64_t index = -1;
};
inline std::string message_text(const Argument& a) {
  std::string text = std::string(a.call) + ", " + a.name;
  if (a.index >= 0) text += "[" + std::to_string(a.index) + "]";
  return text + ": ";
}

inline void check_f32(const Tensor& x, const Argument& argument) {
  novaphy::require(x.defined() && x.dtype() == DType::F32, ErrorKind::Type, argument,
                   "expected float32, got ",
                   x.defined() ? dtype_name(x.dtype()) : "an undefined tensor");
}

// Returns the index of the first value that is not finite, or -1.
inline int64_t first_not_finite(std::span<const float> values) {
  uint32_t found = 0;  // the first pass, over all values, has no branches
  constexpr uint32_t kExponent = 0x7F800000;
  for (const float v : values) found |= (std::bit_cast<uint32_t>(v) & kExponent) == kExponent;
  if (found == 0) return -1;
  return std::ranges::find_if(values, [](float v) { return !std::isfinite(v); }) - values.begin();
}
inline int64_t count_not_finite(std::span<const float> values) {
  return std::ranges::count_if(values, [](float v) { return !std::isfinite(v); });
}

}  // namespace nova::detail
