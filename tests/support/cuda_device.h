// The base of tests that need a CUDA device: a GPU or the fake driver.
#pragma once

#include <gtest/gtest.h>

#include <functional>
#include <string>

#include "novaphy/core/device.h"
#include "novaphy/core/error.h"

namespace novaphy::testing {

class OnCuda : public ::testing::Test {
 protected:
  void SetUp() override {
    try {
      device_info(Device::cuda());
    } catch (const Error& error) {
      GTEST_SKIP() << "needs a CUDA device: " << error.what();
    }
  }
};

inline void expect_thrown(ErrorKind kind, const std::string& words,
                          const std::function<void()>& call) {
  try {
    call();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), kind) << error.what();
    EXPECT_NE(std::string(error.what()).find(words), std::string::npos) << error.what();
    return;
  }
  ADD_FAILURE() << "nothing was thrown: " << words;
}

}  // namespace novaphy::testing
