// A step of VBD as kernels of a device has the bits of the CPU, for every way of updating a color.
#include <gtest/gtest.h>

#include <string>

#include "support/run_command.h"

namespace {

std::string probe(const std::string& environment, const std::string& command) {
  return novaphy::testing::run_command(
             "env -u NOVAPHY_DEVICE NOVAPHY_QUIET=1 NOVAPHY_CUDA_DRIVER=" FAKE_DRIVER
             " NOVAPHY_BACKEND_PATH=" FAKE_DRIVER_PLUGIN_FOLDER " " +
             environment + " " FAKE_DRIVER_PROBE " " + command)
      .output;
}

const std::string kSame =
    "47 particles, cpu replayed same, device same, device replayed same, rollout same\n";

class VbdSweeps : public ::testing::TestWithParam<const char*> {};
TEST_P(VbdSweeps, HaveTheBitsOfTheCpuDirectAndReplayed) {
  EXPECT_EQ(probe(std::string("NOVAPHY_VBD_SWEEP=") + GetParam(), "vbd"), kSame);
}
INSTANTIATE_TEST_SUITE_P(Ways, VbdSweeps, ::testing::Values("thread", "block", "team"));

class VbdDeviceOptions : public ::testing::TestWithParam<const char*> {};
TEST_P(VbdDeviceOptions, HaveTheBitsOfTheCpu) {
  EXPECT_EQ(probe("", std::string("vbd-") + GetParam()), kSame);
}
INSTANTIATE_TEST_SUITE_P(Options, VbdDeviceOptions,
                         ::testing::Values("safeguard", "acceleration", "previous", "coarse"));

TEST(VbdDevice, TheAdaptiveGuessKeepsItsVelocityOnTheDevice) {
  EXPECT_EQ(probe("", "vbd-adaptive"),
            "47 particles, cpu replayed same, device same, device replayed same, rollout same\n");
}

TEST(VbdDevice, AnUnknownWayIsRefusedByName) {
  EXPECT_NE(probe("NOVAPHY_VBD_SWEEP=warp", "vbd").find("NOVAPHY_VBD_SWEEP: expected thread"),
            std::string::npos);
}

}  // namespace
