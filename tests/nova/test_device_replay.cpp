// The choice of the graph for a launch while another thread builds the fused graph. The graphs are
// fakes; the tests on devices use real ones.
#include <gtest/gtest.h>

#include <atomic>
#include <functional>
#include <future>
#include <stdexcept>
#include <string>
#include <thread>

#include "device_replay.h"

namespace {

std::string g_launched;  // a letter for each launch: of a plain graph, or a fused one
std::function<bool()> g_something_fuses;  // runs where the fused graph is made

}  // namespace

namespace nova::detail {

std::unique_ptr<DeviceGraph> DeviceGraph::plain(const novaphy::DeviceContext& context,
                                                std::span<const OpList::Op>,
                                                std::span<const uint64_t>) {
  return std::unique_ptr<DeviceGraph>(new DeviceGraph(context));
}
std::unique_ptr<DeviceGraph> DeviceGraph::fused(const novaphy::DeviceContext& context,
                                                std::span<const OpList::Op> ops,
                                                std::span<const uint64_t> words,
                                                std::span<const MemoryAccess>) {
  if (!g_something_fuses()) return nullptr;
  std::unique_ptr<DeviceGraph> made = plain(context, ops, words);
  made->lists_.push_back({0, 1, nullptr});
  return made;
}
DeviceGraph::~DeviceGraph() = default;
void DeviceGraph::launch() const { g_launched += lists_.empty() ? 'p' : 'f'; }

}  // namespace nova::detail

namespace {

using nova::detail::DeviceReplay;

// A stand-in for a device. Its kernels are numbers that give the way in which the kernel runs.
novaphy::DeviceContext stand_in() {
  static const novaphy_backend_api api = [] {
    novaphy_backend_api made{};
    made.struct_size = sizeof(made);
    made.kernel_info = [](novaphy_kernel* kernel, novaphy_kernel_info* info, novaphy_error*) {
      info->native = *reinterpret_cast<int32_t*>(kernel);
      return NOVAPHY_OK;
    };
    return made;
  }();
  novaphy::DeviceContext context{};
  context.api = &api;
  return context;
}

class DeviceReplayTest : public ::testing::Test {
 protected:
  void SetUp() override { g_launched.clear(); }
  // Launches until the other thread has finished, and returns how the last launch ended.
  static std::string launch_until_ready(DeviceReplay& replay) {
    try {
      while (g_launched.find('f') == std::string::npos) {
        replay.launch();
        std::this_thread::yield();
      }
    } catch (const std::runtime_error& error) {
      return error.what();
    }
    return "";
  }
  const novaphy::DeviceContext context_ = stand_in();
};

TEST_F(DeviceReplayTest, LaunchesRunThePlainGraphUntilTheFusedOneIsThere) {
  std::promise<void> go;
  g_something_fuses = [&] {
    go.get_future().wait();
    return true;
  };
  DeviceReplay replay(context_, {}, {}, {});
  replay.launch();
  replay.launch();
  EXPECT_EQ(g_launched, "pp");
  go.set_value();
  EXPECT_EQ(launch_until_ready(replay), "");
  replay.launch();
  EXPECT_EQ(g_launched.substr(g_launched.find('f')), "ff");
}

TEST_F(DeviceReplayTest, APreparedOneLaunchesTheFusedGraphAtOnce) {
  g_something_fuses = [] {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    return true;
  };
  DeviceReplay replay(context_, {}, {}, {});
  replay.prepare();
  replay.prepare();
  replay.launch();
  EXPECT_EQ(g_launched, "f");
}

TEST_F(DeviceReplayTest, WhatFusesNothingStaysPlain) {
  g_something_fuses = [] { return false; };
  DeviceReplay replay(context_, {}, {}, {});
  replay.launch();
  replay.prepare();
  replay.launch();
  EXPECT_EQ(g_launched, "pp");
}

TEST_F(DeviceReplayTest, AFailureIsThrownOnceAndThePlainGraphRunsOn) {
  g_something_fuses = []() -> bool { throw std::runtime_error("no memory for the table"); };
  DeviceReplay replay(context_, {}, {}, {});
  EXPECT_EQ(launch_until_ready(replay), "no memory for the table");
  g_launched.clear();
  replay.launch();
  replay.prepare();
  EXPECT_EQ(g_launched, "p");
}

TEST_F(DeviceReplayTest, ContractedKernelsWaitBecauseFusingMayChangeTheirBits) {
  int32_t native = 0;
  nova::OpList::Op op{nova::OpList::Op::Kind::Launch};
  op.kernel = reinterpret_cast<novaphy_kernel*>(&native);
  for (; native < 2; ++native) {
    std::promise<void> launched;
    g_something_fuses = [&] {
      launched.get_future().wait();
      return true;
    };
    DeviceReplay replay(context_, {&op, 1}, {}, {});
    replay.launch();
    launched.set_value();
  }
  g_something_fuses = [] {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    return true;
  };
  DeviceReplay(context_, {&op, 1}, {}, {}).launch();
  EXPECT_EQ(g_launched, "ppf");
}

TEST_F(DeviceReplayTest, TheDestructorWaitsForTheThread) {
  std::atomic<bool> done{false};
  g_something_fuses = [&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    done = true;
    return true;
  };
  { const DeviceReplay replay(context_, {}, {}, {}); }
  EXPECT_TRUE(done);
}

TEST_F(DeviceReplayTest, WaitingForCompilersWaitsForTheThreadsOfAll) {
  static std::atomic<int> done;
  done = 0;
  g_something_fuses = [] {
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
    return ++done > 0;
  };
  DeviceReplay one(context_, {}, {}, {}), other(context_, {}, {}, {});
  nova::wait_for_compilers();
  EXPECT_EQ(done, 2);
}

// A list that is never destroyed.
TEST(DeviceReplayDeathTest, TheExitOfTheProcessWaitsForTheThread) {
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(
      {
        static const novaphy::DeviceContext context = stand_in();
        static std::promise<void> started;
        g_something_fuses = [] {
          started.set_value();
          std::this_thread::sleep_for(std::chrono::milliseconds(50));
          std::fputs("made", stderr);
          return true;
        };
        // In sight of leak checkers.
        [[maybe_unused]] static DeviceReplay* volatile left;
        left = new DeviceReplay(context, {}, {}, {});
        started.get_future().wait();
        std::exit(0);
      },
      ::testing::ExitedWithCode(0), "made");
}

}  // namespace
