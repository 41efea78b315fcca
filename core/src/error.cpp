#include "novaphy/core/error.h"

#include <cstdio>
#include <cstdlib>

#include "novaphy/core/assert.h"

namespace novaphy {

// Defined out of line, so that all libraries share one type description of Error and can catch each
// other's errors.
Error::~Error() = default;

MessagePart::MessagePart(int64_t number) : own_(std::to_string(number)), text_(own_) {}
MessagePart::MessagePart(uint64_t number) : own_(std::to_string(number)), text_(own_) {}
MessagePart::MessagePart(double number) {
  char digits[32];
  own_.assign(digits, static_cast<size_t>(std::snprintf(digits, sizeof(digits), "%g", number)));
  text_ = own_;
}

void throw_error(ErrorKind kind, std::span<const MessagePart> parts) {
  std::string message;
  for (const MessagePart& part : parts) message += part.text();
  throw Error(kind, message);
}

void assertion_failed(const char* condition, const char* file, int line) noexcept {
  std::fprintf(stderr, "%s:%d: NOVAPHY_ASSERT(%s) does not hold\n", file, line, condition);
  std::abort();
}

}  // namespace novaphy
