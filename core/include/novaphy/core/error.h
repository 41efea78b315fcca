// The one family of exceptions that NovaPhy throws. Messages name the argument, what was expected
// and what came.
#pragma once

#include <sstream>
#include <stdexcept>
#include <string>

#include "novaphy/core/export.h"

namespace novaphy {

// What kind of mistake it was; the Python binding maps it to the exception in the comment.
enum class ErrorKind {
  Value,           // ValueError: a bad value
  Type,            // TypeError: a wrong dtype or kind of object
  Index,           // IndexError: an index out of range
  NotImplemented,  // NotImplementedError: a feature outside the covered subset
  Runtime,         // novaphy.Error: device, backend or state misuse
};

class NOVAPHY_CORE_API Error : public std::runtime_error {
 public:
  Error(ErrorKind kind, const std::string& message) : std::runtime_error(message), kind_(kind) {}
  Error(const Error&) = default;
  Error& operator=(const Error&) = default;
  ~Error() override;
  ErrorKind kind() const { return kind_; }

 private:
  ErrorKind kind_;
};

// Throws an Error whose message is the streamed parts joined.
template <class... Parts>
[[noreturn]] void fail(ErrorKind kind, const Parts&... parts) {
  std::ostringstream message;
  (message << ... << parts);
  throw Error(kind, message.str());
}

template <class... Parts>
void require(bool condition, ErrorKind kind, const Parts&... parts) {
  if (!condition) [[unlikely]]
    fail(kind, parts...);
}

}  // namespace novaphy
