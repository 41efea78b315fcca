// Internal: checks of arguments whose messages are put together only when something is wrong.
#pragma once

#include <string>

#include "novaphy/core/error.h"
#include "novaphy/nova/tensor.h"

namespace nova::detail {

// "adam_update_f32, m: ", or "Adam, params[2]: " for an entry of a list.
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

}  // namespace nova::detail
