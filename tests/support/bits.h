// Comparison of floats by their bits. For tests.
#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <cstring>
#include <iomanip>
#include <span>

#include "novaphy/core/error.h"

namespace novaphy::testing {

// Every 4-byte word of the two ranges is equal; the message names the first that is not.
template <class T>
::testing::AssertionResult same_bits(std::span<const T> actual, std::span<const T> expected) {
  static_assert(sizeof(T) % 4 == 0);
  if (actual.size() != expected.size()) {
    return ::testing::AssertionFailure()
           << "expected " << expected.size() << " elements, got " << actual.size();
  }
  const size_t words = actual.size_bytes() / 4;
  const auto* a = reinterpret_cast<const unsigned char*>(actual.data());
  const auto* b = reinterpret_cast<const unsigned char*>(expected.data());
  size_t different = 0, first = 0;
  for (size_t i = words; i-- > 0;) {
    if (std::memcmp(a + 4 * i, b + 4 * i, 4) != 0) {
      first = i;
      ++different;
    }
  }
  if (different == 0) return ::testing::AssertionSuccess();
  float x, y;
  std::memcpy(&x, a + 4 * first, 4);
  std::memcpy(&y, b + 4 * first, 4);
  constexpr size_t kPerElement = sizeof(T) / 4;
  return ::testing::AssertionFailure()
         << different << " of " << words << " words differ, first element " << first / kPerElement
         << " component " << first % kPerElement << ": got " << std::setprecision(9) << x
         << ", expected " << y;
}

// Expects that the statement throws a novaphy::Error of this kind with the text in its message.
#define EXPECT_ERROR(statement, expected_kind, text)                                            \
  try {                                                                                         \
    statement;                                                                                  \
    ADD_FAILURE() << #statement " did not throw";                                               \
  } catch (const ::novaphy::Error& error) {                                                     \
    EXPECT_EQ(static_cast<int>(error.kind()), static_cast<int>(expected_kind)) << error.what(); \
    EXPECT_NE(std::string_view(error.what()).find(text), std::string_view::npos)                \
        << "message: " << error.what();                                                         \
  }

}  // namespace novaphy::testing
