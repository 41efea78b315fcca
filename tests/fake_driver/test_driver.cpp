// The CUDA backend if the driver is missing, old, without a device, out of memory, or has lost its
// device. Each test runs a process of its own, because a process opens the driver once.
#include <gtest/gtest.h>

#include <string>

#include "support/run_command.h"

namespace {

using novaphy::testing::Outcome;

Outcome probe(const std::string& environment, const std::string& command) {
  return novaphy::testing::run_command("env -u NOVAPHY_DEVICE " + environment +
                                       " " FAKE_DRIVER_PROBE " " + command);
}

const std::string kFake = "NOVAPHY_CUDA_DRIVER=" FAKE_DRIVER " ";

void expect_refused(const std::string& environment, const std::string& reason) {
  const Outcome outcome = probe(environment, "device");
  EXPECT_EQ(outcome.code, 1);
  EXPECT_NE(outcome.output.find("error: cuda backend not available: "), std::string::npos)
      << outcome.output;
  EXPECT_NE(outcome.output.find(reason), std::string::npos) << outcome.output;
}

TEST(FakeDriver, ADeviceOpensAndDescribesItself) {
  const Outcome outcome = probe(kFake, "device");
  EXPECT_EQ(outcome.output, "Fake GPU sm_90 4 units, graphs 1\n");
  EXPECT_EQ(outcome.code, 0);
}

TEST(FakeDriver, BytesComeBackThroughCopiesAndFills) {
  EXPECT_EQ(probe(kFake, "round_trip").output, "sum 2500\n");
}

TEST(FakeDriver, ADriverThatIsNotThereIsNamed) {
  expect_refused("NOVAPHY_CUDA_DRIVER=/nowhere/libcuda.so.1", "NOVAPHY_CUDA_DRIVER: ");
  expect_refused("NOVAPHY_CUDA_DRIVER=/nowhere/libcuda.so.1", "/nowhere/libcuda.so.1");
}

TEST(FakeDriver, AMissingSymbolIsNamedWithTheVersions) {
  expect_refused("NOVAPHY_CUDA_DRIVER=" FAKE_DRIVER_WITHOUT_SYMBOL " FAKE_DRIVER_VERSION=11010",
                 "no symbol cuMemAllocAsync; it is of CUDA 11.1, expected 12.0 or later");
}

TEST(FakeDriver, AnOldDriverIsRefusedWithBothVersions) {
  expect_refused(kFake + "FAKE_DRIVER_VERSION=11080",
                 "the driver is too old: it is of CUDA 11.8, expected 12.0 or later");
}

TEST(FakeDriver, NoDeviceAndADriverThatDoesNotStartAreReasons) {
  expect_refused(kFake + "FAKE_DRIVER_DEVICES=0", "no device is visible (driver of CUDA 13.0)");
  expect_refused(kFake + "FAKE_DRIVER_INIT=3", "the driver did not start: CUDA_ERROR_FAKE");
}

TEST(FakeDriver, RunningOutOfMemoryIsAnErrorAndTheDeviceWorksOn) {
  const Outcome outcome = probe(kFake + "FAKE_DRIVER_MEMORY=1000000", "memory");
  EXPECT_EQ(outcome.code, 0);
  EXPECT_NE(outcome.output.find("error: Storage.allocate: memory_alloc: no "), std::string::npos)
      << outcome.output;
  EXPECT_NE(outcome.output.find("the device has 1000000 in all\nsum 2500\n"), std::string::npos)
      << outcome.output;
}

TEST(FakeDriver, ALostDeviceIsReportedFromThenOnAndTheProcessSurvives) {
  const Outcome outcome = probe(kFake + "FAKE_DRIVER_LOSE=4", "lose");
  EXPECT_EQ(outcome.code, 0);
  EXPECT_EQ(outcome.output.rfind("worked\nerror: ", 0), 0u) << outcome.output;
  const std::string lost = "device cuda:0 is lost since ";
  const size_t first = outcome.output.find(lost);
  ASSERT_NE(first, std::string::npos) << outcome.output;
  EXPECT_NE(outcome.output.find("CUDA_ERROR_ILLEGAL_ADDRESS", first), std::string::npos);
  EXPECT_NE(outcome.output.find(lost, first + 1), std::string::npos) << outcome.output;
  EXPECT_NE(outcome.output.find("the cpu gives 3\n"), std::string::npos) << outcome.output;
}

const std::string kAhead = kFake + "NOVAPHY_BACKEND_PATH=" FAKE_DRIVER_PLUGIN_FOLDER " ";
const std::string kSaid = "novaphy: kernels that were not built ahead are interpreted";

TEST(FakeDriver, WithoutACompilerKernelsAreInterpretedWhichIsSaidOnce) {
  const std::string output = probe(kAhead, "kernels").output;
  EXPECT_NE(output.find("2 6 12 \n"), std::string::npos) << output;
  const size_t said = output.find(kSaid);
  ASSERT_NE(said, std::string::npos) << output;
  EXPECT_NE(output.find("NOVA_ENABLE_NVRTC=OFF", said), std::string::npos) << output;
  EXPECT_EQ(output.find(kSaid, said + 1), std::string::npos) << output;
  EXPECT_EQ(probe(kAhead + "NOVAPHY_QUIET=1 ", "kernels").output, "2 6 12 \n");
}

TEST(FakeDriver, TheForwardSolverStepsAModelOnTheDeviceWithTheBitsOfTheCpu) {
  EXPECT_EQ(probe(kAhead + "NOVAPHY_QUIET=1 ", "step").output, "17 particles, the same bits\n");
}

// One header text, read by the compiler of the engine and as the device's.
TEST(FakeDriver, TheSearchForContactsGivesTheBitsOfTheCpuDirectAndReplayed) {
  EXPECT_EQ(probe(kAhead + "NOVAPHY_QUIET=1 ", "collide").output,
            "500 contacts, the same direct, the same replayed\n");
}

TEST(FakeDriver, AKernelOverMemoryOfTwoDevicesIsRefused) {
  EXPECT_EQ(probe(kAhead, "mix").output,
            "error: copy_row, x: expected memory of cuda:0, got cpu\n");
}

TEST(FakeDriver, AnInterpreterThatWasAskedForIsNotSaid) {
  EXPECT_EQ(probe(kAhead + "NOVAPHY_DEVICE_INTERPRETER=1 ", "kernels").output, "2 6 12 \n");
}

TEST(FakeDriver, ContractionIsOnOrOffAndNeedsACompiler) {
  EXPECT_NE(probe(kAhead + "NOVAPHY_CUDA_CONTRACT=yes ", "kernels")
                .output.find("NOVAPHY_CUDA_CONTRACT: expected on or off, got \"yes\""),
            std::string::npos);
  EXPECT_NE(
      probe(kAhead + "NOVAPHY_CUDA_CONTRACT=on ", "kernels")
          .output.find("cannot be compiled: this plugin was built with NOVA_ENABLE_NVRTC=OFF"),
      std::string::npos);
  EXPECT_EQ(probe(kAhead + "NOVAPHY_QUIET=1 NOVAPHY_CUDA_CONTRACT=off ", "kernels").output,
            "2 6 12 \n");
}

TEST(FakeDriver, WithoutACompilerAndAnInterpreterTheErrorNamesBoth) {
  const std::string output =
      probe(kFake + "NOVAPHY_BACKEND_PATH=" FAKE_DRIVER_EMPTY_PLUGIN_FOLDER " ", "kernels").output;
  EXPECT_NE(output.find("error: "), std::string::npos) << output;
  EXPECT_NE(output.find("no interpreter for sm_90 was built ahead"), std::string::npos) << output;
  EXPECT_NE(output.find("NOVA_ENABLE_NVRTC=OFF"), std::string::npos) << output;
}

}  // namespace
