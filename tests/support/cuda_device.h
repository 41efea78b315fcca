// Tests that need a CUDA device, a GPU or the fake driver.
#pragma once

#include <gtest/gtest.h>

#include <cstdlib>
#include <functional>
#include <initializer_list>
#include <string>
#include <vector>

#include "novaphy/core/device.h"
#include "novaphy/core/error.h"

namespace novaphy::testing {

// With these environment variables on.
class OnCuda : public ::testing::Test {
 protected:
  explicit OnCuda(std::initializer_list<const char*> opt_ins) : opt_ins_(opt_ins) {}
  void SetUp() override {
    try {
      device_info(Device::cuda());
    } catch (const Error& error) {
      GTEST_SKIP() << "needs a CUDA device: " << error.what();
    }
    for (const char* name : opt_ins_) setenv(name, "on", 1);
  }
  void TearDown() override {
    for (const char* name : opt_ins_) unsetenv(name);
  }

 private:
  const std::vector<const char*> opt_ins_;
};

inline void expect_thrown(ErrorKind kind, const char* words, const std::function<void()>& call) {
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
