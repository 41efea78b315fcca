#include <gtest/gtest.h>

#include <fstream>

#include "cpu_limits.h"
#include "novaphy/core/parallel.h"

namespace novaphy {
namespace {

namespace fs = std::filesystem;

class CgroupLimit : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string name = (fs::temp_directory_path() / "novaphy_cgroup_XXXXXX").string();
    root_ = mkdtemp(name.data());
  }
  void TearDown() override { fs::remove_all(root_); }

  void write(const std::string& path, const std::string& text) {
    fs::create_directories((root_ / path).parent_path());
    std::ofstream(root_ / path) << text;
  }
  int limit() const { return cgroup_cpu_limit(root_); }

  fs::path root_;
};

TEST_F(CgroupLimit, IsAbsentWithoutFiles) { EXPECT_EQ(limit(), 0); }

TEST_F(CgroupLimit, V2RoundsTheQuotaUp) {
  write("proc/self/cgroup", "0::/work/job\n");
  write("sys/fs/cgroup/work/job/cpu.max", "250000 100000\n");
  EXPECT_EQ(limit(), 3);
  write("sys/fs/cgroup/work/job/cpu.max", "10000 100000\n");
  EXPECT_EQ(limit(), 1);
  write("sys/fs/cgroup/work/job/cpu.max", "max 100000\n");
  EXPECT_EQ(limit(), 0);
}

TEST_F(CgroupLimit, V2TakesTheSmallestOnTheWayUp) {
  write("proc/self/cgroup", "0::/work/job\n");
  write("sys/fs/cgroup/work/job/cpu.max", "800000 100000\n");
  write("sys/fs/cgroup/work/cpu.max", "200000 100000\n");
  EXPECT_EQ(limit(), 2);
}

TEST_F(CgroupLimit, TheRootOfTheMountStandsForAGroupThatAContainerHides) {
  write("proc/self/cgroup", "0::/../not/here\n");
  write("sys/fs/cgroup/cpu.max", "400000 100000\n");
  EXPECT_EQ(limit(), 4);
}

TEST_F(CgroupLimit, V1ReadsTheCpuController) {
  write("proc/self/cgroup", "3:cpuset:/other\n4:cpu,cpuacct:/job\n1:name=systemd:/x\n");
  write("sys/fs/cgroup/cpu,cpuacct/job/cpu.cfs_quota_us", "150000\n");
  write("sys/fs/cgroup/cpu,cpuacct/job/cpu.cfs_period_us", "100000\n");
  EXPECT_EQ(limit(), 2);
  write("sys/fs/cgroup/cpu,cpuacct/job/cpu.cfs_quota_us", "-1\n");
  EXPECT_EQ(limit(), 0);
}

TEST_F(CgroupLimit, V1AlsoUnderTheShortName) {
  write("proc/self/cgroup", "4:cpu,cpuacct:/job\n");
  write("sys/fs/cgroup/cpu/cpu.cfs_quota_us", "300000\n");
  write("sys/fs/cgroup/cpu/cpu.cfs_period_us", "100000\n");
  EXPECT_EQ(limit(), 3);
}

TEST_F(CgroupLimit, NonsenseIsNoLimit) {
  write("proc/self/cgroup", "0::/job\nnonsense\n:\n");
  for (const char* text : {"", "abc def", "0 0", "-5 100000", "100000", "100000 0"}) {
    write("sys/fs/cgroup/job/cpu.max", text);
    EXPECT_EQ(limit(), 0) << text;
  }
}

TEST(AvailableCpus, IsAtLeastOneAndAtMostTheAffinityMask) {
  EXPECT_GE(available_cpus(), 1);
  EXPECT_LE(available_cpus(), affinity_cpus());
}

}  // namespace
}  // namespace novaphy
