// Compares results of a device with those of the CPU, byte by byte.
#pragma once

#include <gtest/gtest.h>

#include <cstddef>
#include <cstring>
#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "novaphy/core/device.h"

namespace novaphy::testing {

using Bytes = std::vector<std::byte>;
template <class T>
Bytes bytes(const std::vector<T>& values) {
  Bytes all(values.size() * sizeof(T));
  if (!values.empty()) std::memcpy(all.data(), values.data(), all.size());
  return all;
}
using Result = std::vector<std::pair<std::string, Bytes>>;

inline void expect_same(const Result& actual, const Result& expected, const std::string& what) {
  ASSERT_EQ(actual.size(), expected.size());
  for (size_t k = 0; k < actual.size(); ++k)
    EXPECT_TRUE(actual[k].second == expected[k].second) << actual[k].first << what;
}
inline void expect_same_bits(const std::function<Result(Device)>& run) {
  const Result expected = run(Device::cpu());
  expect_same(run(Device::cuda()), expected, "");
}

}  // namespace novaphy::testing
