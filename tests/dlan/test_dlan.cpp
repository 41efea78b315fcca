// The Denglin backend with a run-time library that simulates a device on the host. The library may
// be missing, old, renamed, without a device, out of memory, or lose its device. Kernels give the
// bits of the CPU. Each test runs a process of its own, because a process opens the library once.
#include <gtest/gtest.h>

#include <fstream>
#include <string>

#include "support/run_command.h"

namespace {

using novaphy::testing::Outcome;

const std::string kKernels = "NOVAPHY_QUIET=1 NOVAPHY_DLAN_KERNELS=" FAKE_KERNELS " ";
const std::string kFake = kKernels + "NOVAPHY_DLAN_LIBRARY=" FAKE " ";

Outcome probe(const std::string& environment, const std::string& command,
              const std::string& program = PROBE) {
  return novaphy::testing::run_command("env -u NOVAPHY_DEVICE -u NOVAPHY_DLAN_ROOT " + environment +
                                       " " + program + " " + command + " dlan:0");
}

void expect_refused(const std::string& environment, const std::string& reason) {
  const Outcome outcome = probe(environment, "device");
  EXPECT_EQ(outcome.code, 1);
  EXPECT_NE(outcome.output.find("error: dlan backend not available: "), std::string::npos)
      << outcome.output;
  EXPECT_NE(outcome.output.find(reason), std::string::npos) << outcome.output;
}

std::string symbols_file(const std::string& name, const std::string& text) {
  const std::string path = FOLDER "/" + name;
  std::ofstream(path) << text;
  return "NOVAPHY_DLAN_SYMBOLS=" + path + " ";
}

TEST(FakeDlan, ADeviceDescribesItselfAndHasNoGraphs) {
  const Outcome outcome = probe(kFake, "device");
  EXPECT_EQ(outcome.output, "Fake Denglin sm_70 4 units, graphs 0\n");
  EXPECT_EQ(outcome.code, 0);
}

TEST(FakeDlan, BytesComeBackThroughCopiesAndFills) {
  EXPECT_EQ(probe(kFake, "round_trip").output, "sum 2500\n");
}

TEST(FakeDlan, ALibraryThatIsNotThereIsNamed) {
  expect_refused(kKernels + "NOVAPHY_DLAN_LIBRARY=/nowhere/libcurt.so",
                 "NOVAPHY_DLAN_LIBRARY or NOVAPHY_DLAN_ROOT: /nowhere/libcurt.so");
  expect_refused(kKernels + "NOVAPHY_DLAN_ROOT=/nowhere", "/nowhere/lib/libcurt.so");
  expect_refused(kKernels, "no Denglin driver on this machine (libcurt.so");
}

TEST(FakeDlan, KernelsThatAreNotThereAreNamedWithWhatMakesThem) {
  expect_refused("NOVAPHY_DLAN_LIBRARY=" FAKE " NOVAPHY_DLAN_KERNELS=/nowhere/kernels.so",
                 "no kernels: /nowhere/kernels.so");
  expect_refused("NOVAPHY_DLAN_LIBRARY=" FAKE " NOVAPHY_DLAN_KERNELS=/nowhere/kernels.so",
                 "python -m novaphy.backend_check dlan");
  expect_refused("NOVAPHY_DLAN_LIBRARY=" FAKE " NOVAPHY_DLAN_KERNELS=" FAKE,
                 "has no symbol novaphy_dlan_modules");
}

TEST(FakeDlan, AMissingSymbolIsNamedWithTheVersions) {
  expect_refused(kKernels + "FAKE_DLAN_VERSION=8000 NOVAPHY_DLAN_LIBRARY=" FAKE_LACKS_SYMBOL,
                 "no symbol cudaMemsetAsync; it is of Denglin 8.0, expected 9.0 or later");
}

TEST(FakeDlan, AnOldLibraryIsRefusedWithBothVersions) {
  expect_refused(kFake + "FAKE_DLAN_VERSION=8000",
                 "too old: it is of Denglin 8.0, expected 9.0 or later");
}

TEST(FakeDlan, AFileReplacesNames) {
  const std::string other = kKernels + "NOVAPHY_DLAN_LIBRARY=" FAKE_OTHER_NAME " ";
  expect_refused(other, "no symbol cudaMemsetAsync");
  EXPECT_EQ(probe(other + symbols_file("renamed",
                                       "# as the library has it\n"
                                       "cudaMemsetAsync = dlMemsetAsync\n"),
                  "round_trip")
                .output,
            "sum 2500\n");
  // A runtime without the function for its version is not asked for the version.
  EXPECT_EQ(probe(kFake + "FAKE_DLAN_VERSION=8000 " +
                      symbols_file("without", "cudaRuntimeGetVersion =\n"),
                  "round_trip")
                .output,
            "sum 2500\n");
  expect_refused(kFake + symbols_file("wrong", "\ncudaMalloc dlMalloc\n"), "wrong:2: expected");
  expect_refused(kFake + symbols_file("unknown", "cudaNothing = dlNothing\n"),
                 "unknown:1: expected");
  expect_refused(kFake + "NOVAPHY_DLAN_SYMBOLS=/nowhere/names ", "cannot read /nowhere/names");
}

TEST(FakeDlan, NoDeviceIsAReason) {
  expect_refused(kFake + "FAKE_DLAN_DEVICES=0", "no device is visible (driver of Denglin 11.0)");
}

TEST(FakeDlan, RunningOutOfMemoryIsAnErrorAndTheDeviceWorksOn) {
  const Outcome outcome = probe(kFake + "FAKE_DLAN_MEMORY=1000000", "memory");
  EXPECT_EQ(outcome.code, 0);
  EXPECT_NE(outcome.output.find("error: Storage.allocate: memory_alloc: no "), std::string::npos)
      << outcome.output;
  EXPECT_NE(outcome.output.find("the device has 1000000 in all\nsum 2500\n"), std::string::npos)
      << outcome.output;
}

TEST(FakeDlan, ALostDeviceIsReportedFromThenOnAndTheProcessSurvives) {
  const Outcome outcome = probe(kFake + "FAKE_DLAN_LOSE=4", "lose");
  EXPECT_EQ(outcome.code, 0);
  EXPECT_EQ(outcome.output.rfind("worked\nerror: ", 0), 0u) << outcome.output;
  const std::string lost = "device dlan:0 is lost since ";
  const size_t first = outcome.output.find(lost);
  ASSERT_NE(first, std::string::npos) << outcome.output;
  EXPECT_NE(outcome.output.find("cudaErrorIllegalAddress", first), std::string::npos);
  EXPECT_NE(outcome.output.find(lost, first + 1), std::string::npos) << outcome.output;
  EXPECT_NE(outcome.output.find("the cpu gives 3\n"), std::string::npos) << outcome.output;
}

class OnWarps : public testing::TestWithParam<int> {
 protected:
  std::string fake() const { return kFake + "FAKE_DLAN_WARP=" + std::to_string(GetParam()) + " "; }
};
TEST_P(OnWarps, TheForwardSolverStepsAModelWithTheBitsOfTheCpu) {
  EXPECT_EQ(probe(fake(), "step").output, "17 particles, the same bits\n");
}
TEST_P(OnWarps, TheSearchForContactsGivesTheBitsOfTheCpuDirectAndReplayed) {
  EXPECT_EQ(probe(fake(), "collide").output, "500 contacts, the same direct, the same replayed\n");
}
TEST_P(OnWarps, ACapturedIterationOfTheBallHasTheBitsOfTheCpu) {
  const std::string output = probe(fake(), "ball", SCENES).output;
  EXPECT_NE(output.find(" and 15 gradients have the same bits\n"), std::string::npos) << output;
}
TEST_P(OnWarps, ACapturedIterationOfTheSoftBodyHasTheBitsOfTheCpu) {
  const std::string output = probe(fake(), "soft_body", SCENES).output;
  EXPECT_NE(output.find(" and 81 gradients have the same bits\n"), std::string::npos) << output;
}
TEST_P(OnWarps, ACapturedIterationOfClothHasTheBitsOfTheCpu) {
  const std::string output = probe(fake(), "cloth", SCENES).output;
  EXPECT_NE(output.find(" and 90 gradients have the same bits\n"), std::string::npos) << output;
}
TEST_P(OnWarps, RigidBodiesMeetWithTheBitsOfTheCpuDirectAndReplayed) {
  EXPECT_EQ(probe(fake(), "rigid_contacts", SCENES).output,
            "rows of contacts, same, same, same, same, same, same\n");
}
TEST_P(OnWarps, ACapturedIterationOfRigidBodiesHasTheBitsOfTheCpu) {
  const std::string output = probe(fake(), "rigid", SCENES).output;
  EXPECT_EQ(output.rfind("loss ", 0), 0u) << output;
  EXPECT_NE(output.find(" and 15 gradients have the same bits\n"), std::string::npos) << output;
}
TEST_P(OnWarps, ArticulationsStepWithTheBitsOfTheCpuDirectAndReplayed) {
  EXPECT_EQ(probe(fake(), "articulations", SCENES).output, "18300 numbers, same, same\n");
}
TEST_P(OnWarps, GradientsThroughContactsOfArticulationsHaveTheBitsOfTheCpuDirectAndReplayed) {
  EXPECT_EQ(probe(fake(), "contact_gradients", SCENES).output, "contacts, same, same\n");
}
TEST_P(OnWarps, ACapturedIterationOfAnArticulationHasTheBitsOfTheCpu) {
  const std::string output = probe(fake(), "articulation", SCENES).output;
  EXPECT_NE(output.find(" and 53 gradients have the same bits\n"), std::string::npos) << output;
}
#ifdef DLAN_HAS_VBD
const std::string kSameVbd =
    "47 particles, cpu replayed same, device same, device replayed same, rollout same\n";
TEST_P(OnWarps, VbdHasTheBitsOfTheCpuWithAThreadOrATeamOfThreads) {
  for (const char* way : {"", "thread", "block"})
    EXPECT_EQ(probe(fake() + "NOVAPHY_VBD_SWEEP=" + way, "vbd", SCENES).output, kSameVbd) << way;
}
TEST_P(OnWarps, OptionsOfVbdHaveTheBitsOfTheCpu) {
  for (const char* option : {"vbd-safeguard", "vbd-acceleration", "vbd-previous"})
    EXPECT_EQ(probe(fake(), option, SCENES).output, kSameVbd) << option;
}
TEST_P(OnWarps, GradientsOfVbdHaveTheBitsOfTheCpu) {
  EXPECT_EQ(probe(fake(), "vbd_gradients", SCENES).output, "2476 numbers, same, same, same\n");
}
#endif
INSTANTIATE_TEST_SUITE_P(Widths, OnWarps, testing::Values(1, 32, 64));

// Kernels that were not built ahead of time are interpreted, or compiled by a command.
TEST(FakeDlan, OtherKernelsAreInterpretedWhichIsSaidOrCompiledByACommand) {
  const std::string loud = "NOVAPHY_DLAN_KERNELS=" FAKE_KERNELS " NOVAPHY_DLAN_LIBRARY=" FAKE " ";
  const std::string said = probe(loud, "own_kernel", SCENES).output;
  EXPECT_NE(said.find("interpreted on the Denglin device"), std::string::npos) << said;
  EXPECT_NE(said.find("NOVAPHY_DLAN_COMPILER names no command"), std::string::npos) << said;
  EXPECT_NE(said.find("interpreted 5 9 13 \n"), std::string::npos) << said;

  const std::string command = FOLDER "/compile_for_host.sh";
  std::ofstream(command)
      << "#!/bin/sh\nexec " HOST_COMPILER " -std=c++20 -x c++ -include " TESTS
         "/dlan/host.h -I" TESTS
         " -w -O1 -fno-strict-aliasing -ffp-contract=off -fPIC -shared -o \"$1\" \"$2\"\n";
  ASSERT_EQ(std::system(("chmod +x " + command).c_str()), 0);
  const std::string compiling =
      loud + "NOVAPHY_CACHE_DIR=off NOVAPHY_DLAN_COMPILER=" + command + " ";
  EXPECT_EQ(probe(compiling, "own_kernel", SCENES).output, "compiled 5 9 13 \n");
  const std::string failing = loud + "NOVAPHY_CACHE_DIR=off NOVAPHY_DLAN_COMPILER=/bin/false ";
  EXPECT_NE(
      probe(failing, "own_kernel", SCENES).output.find("does not compile: /bin/false ended with 1"),
      std::string::npos);
}

}  // namespace
