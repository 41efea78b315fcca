// What the tests of articulations on devices share.
#pragma once

#include <gtest/gtest.h>

#include <cstdlib>
#include <functional>
#include <string>
#include <utility>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/sim_state.h"
#include "support/device_bits.h"

namespace novaphy {

class ArticulationDevices : public ::testing::Test {
 protected:
  static constexpr const char* kOptIn = "NOVAPHY_UNVERIFIED_DEVICE_ARTICULATIONS";
  static constexpr const char* kContactsOptIn = "NOVAPHY_UNVERIFIED_DEVICE_CONTACTS";
  void SetUp() override {
    try {
      device_info(Device::cuda());
    } catch (const Error& error) {
      GTEST_SKIP() << "needs a CUDA device: " << error.what();
    }
    setenv(kOptIn, "on", 1);
    setenv(kContactsOptIn, "on", 1);
  }
  void TearDown() override {
    unsetenv(kOptIn);
    unsetenv(kContactsOptIn);
  }
};

namespace testing {

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

inline void add(Result& result, const SimState& s, const std::string& when) {
  result.emplace_back(when + " joint_q", bytes(s.joint_q.to_host()));
  result.emplace_back(when + " joint_qd", bytes(s.joint_qd.to_host()));
  result.emplace_back(when + " body_q", bytes(s.body_q.to_host()));
  result.emplace_back(when + " body_qd", bytes(s.body_qd.to_host()));
}

}  // namespace testing
}  // namespace novaphy
