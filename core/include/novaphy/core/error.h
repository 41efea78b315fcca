// Error: the only exception type that NovaPhy throws. A message names the argument, the expected
// value and the given value.
#pragma once

#include <concepts>
#include <cstdint>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>

#include "novaphy/core/export.h"

namespace novaphy {

// The kind of an error. The Python binding raises the exception that the comment names.
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

// One part of an error message: a text, or a number as a stream prints it. A type T becomes usable
// as a part by a function message_text(const T&) in its namespace.
class NOVAPHY_CORE_API MessagePart {
 public:
  MessagePart(std::string_view text) : text_(text) {}
  MessagePart(const std::string& text) : text_(text) {}
  MessagePart(const char* text) : text_(text) {}
  MessagePart(char letter) : own_(1, letter), text_(own_) {}
  template <std::signed_integral T>
  MessagePart(T number) : MessagePart(static_cast<int64_t>(number)) {}
  template <std::unsigned_integral T>
  MessagePart(T number) : MessagePart(static_cast<uint64_t>(number)) {}
  MessagePart(int64_t number);
  MessagePart(uint64_t number);
  MessagePart(double number);  // six significant digits
  template <class T>
  requires requires(const T& value) { message_text(value); }
  MessagePart(const T& value) : own_(message_text(value)), text_(own_) {}
  MessagePart(const MessagePart&) = delete;
  MessagePart& operator=(const MessagePart&) = delete;

  std::string_view text() const { return text_; }

 private:
  std::string own_;
  std::string_view text_;
};

// Throws an Error whose message joins the parts.
[[noreturn]] NOVAPHY_CORE_API void throw_error(ErrorKind kind, std::span<const MessagePart> parts);

template <class... Parts>
[[noreturn]] [[gnu::cold, gnu::noinline]] void fail(ErrorKind kind, const Parts&... parts) {
  const MessagePart message[] = {MessagePart(parts)...};
  throw_error(kind, message);
}

template <class... Parts>
void require(bool condition, ErrorKind kind, const Parts&... parts) {
  if (!condition) [[unlikely]]
    fail(kind, parts...);
}

}  // namespace novaphy
