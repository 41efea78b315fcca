// Runs NOVAPHY_TRACE in a separate process. tests/python/test_trace.py reads the files.
#include <gtest/gtest.h>

#include <string>

#include "support/run_command.h"

namespace novaphy::testing {
namespace {

const std::string kLaunch = " " NOVAPHY_PROBE " launch exclusive_scan_i32";

TEST(LaunchTrace, AnEmptyVariableTracesNothing) {
  const Outcome run = run_command("NOVAPHY_TRACE=" + kLaunch);
  EXPECT_EQ(run.code, 0);
  EXPECT_EQ(run.output, "launched\n");
}

#ifdef NOVAPHY_FAKE_NVTX
TEST(LaunchTrace, ALaunchIsARangeOfNvtx) {
  const Outcome run =
      run_command("LD_LIBRARY_PATH=" NOVAPHY_FAKE_NVTX " NOVAPHY_TRACE=nvtx" + kLaunch);
  EXPECT_EQ(run.code, 0);
  EXPECT_EQ(run.output, "push exclusive_scan_i32\npop\nlaunched\n");
}

TEST(LaunchTrace, NamesTheLibraryThatIsNotThere) {
  const Outcome run = run_command("LD_LIBRARY_PATH=/nowhere NOVAPHY_TRACE=nvtx" + kLaunch);
  EXPECT_EQ(run.code, 1);
  EXPECT_NE(run.output.find("error: NOVAPHY_TRACE: expected the library of NVTX for \"nvtx\", got: "
                            "libnvToolsExt.so.1"),
            std::string::npos)
      << run.output;
}
#else
TEST(LaunchTrace, RangesOfNvtxNeedTheCudaBackend) {
  const Outcome run = run_command("NOVAPHY_TRACE=nvtx" + kLaunch);
  EXPECT_EQ(run.code, 1);
  EXPECT_EQ(run.output,
            "error: NOVAPHY_TRACE: expected a file, because this build has no CUDA backend, got "
            "\"nvtx\"\n");
}
#endif

}  // namespace
}  // namespace novaphy::testing
