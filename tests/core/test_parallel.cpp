#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <mutex>
#include <set>
#include <stdexcept>
#include <thread>
#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/core/parallel.h"
#include "novaphy/cpu/float_mode.h"
#include "support/probe.h"

namespace novaphy {
namespace {

// Calls a C++ callable for every chunk.
template <class F>
void for_chunks(int64_t chunks, F&& f) {
  parallel_for(
      chunks,
      [](void* context, int64_t chunk) {
        (*static_cast<std::remove_reference_t<F>*>(context))(chunk);
      },
      &f);
}

class Parallel : public ::testing::TestWithParam<int> {
 protected:
  void SetUp() override {
    before_ = num_threads();
    set_num_threads(GetParam());
  }
  void TearDown() override { set_num_threads(before_); }
  int before_ = 1;
};

TEST_P(Parallel, RunsEveryChunkOnce) {
  for (const int64_t chunks : {0, 1, 2, 3, 100, 10007}) {
    std::vector<std::atomic<int>> runs(static_cast<size_t>(chunks));
    for_chunks(chunks, [&](int64_t chunk) { ++runs[static_cast<size_t>(chunk)]; });
    for (const auto& count : runs) ASSERT_EQ(count, 1);
  }
}

// Helper threads wait for the next job for some time. Some jobs follow at once, others after this
// time.
TEST_P(Parallel, SmallJobsOneAfterAnotherAreDoneBeforeTheyReturn) {
  std::vector<int64_t> written(40);
  for (int job = 0; job < 3000; ++job) {
    const int64_t chunks = 2 + job % 39;
    for_chunks(chunks, [&](int64_t chunk) { written[static_cast<size_t>(chunk)] = job; });
    for (int64_t chunk = 0; chunk < chunks; ++chunk)
      ASSERT_EQ(written[static_cast<size_t>(chunk)], job) << "chunk " << chunk << " of " << chunks;
    if (job % 300 == 0) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
}

TEST_P(Parallel, PhasesBeginWhenAllChunksOfTheOneBeforeAreDone) {
  for (const int64_t most : {1, 2, 5, 40}) {
    constexpr int64_t kFirst = 3;
    std::vector<int64_t> ends, phase_of(kFirst);
    for (int64_t phase = 0, end = kFirst; phase < 500; ++phase) {
      end += (phase * 7) % (most + 1);  // some have none
      ends.push_back(end);
      phase_of.resize(static_cast<size_t>(end), phase);
    }
    struct Run {
      const std::vector<int64_t>&ends, &phase_of;
      std::vector<std::atomic<int64_t>> done;
      std::atomic<int> early{0};
    } run{ends, phase_of, std::vector<std::atomic<int64_t>>(ends.size() + 1)};
    parallel_phases(
        kFirst, ends,
        [](void* context, int64_t chunk) {
          Run& r = *static_cast<Run*>(context);
          const auto phase = static_cast<size_t>(r.phase_of[static_cast<size_t>(chunk)]);
          for (size_t p = phase < 3 ? 0 : phase - 3; p < phase; ++p) {
            const int64_t begin = p == 0 ? kFirst : r.ends[p - 1];
            r.early += r.done[p] != r.ends[p] - begin;
          }
          ++r.done[phase];
        },
        &run);
    EXPECT_EQ(run.early, 0);
    for (size_t p = 0; p < ends.size(); ++p)
      ASSERT_EQ(run.done[p], ends[p] - (p == 0 ? kFirst : ends[p - 1])) << "phase " << p;
  }
}

TEST_P(Parallel, AnExceptionEndsThePhases) {
  const std::vector<int64_t> ends = {10, 20, 30};
  std::atomic<int> late{0};
  const auto body = [](void* context, int64_t chunk) {
    if (chunk == 13) throw std::runtime_error("chunk 13");
    if (chunk >= 20) ++*static_cast<std::atomic<int>*>(context);
  };
  EXPECT_THROW(parallel_phases(0, ends, body, &late), std::runtime_error);
  EXPECT_EQ(late, 0);
}

TEST_P(Parallel, UsesAsManyThreadsAsAsked) {
  std::set<std::thread::id> seen;
  std::mutex mutex;
  std::atomic<int> arrived{0};
  // Every chunk waits until all threads have come, so that none can do the work of two.
  for_chunks(GetParam(), [&](int64_t) {
    ++arrived;
    const auto limit = std::chrono::steady_clock::now() + std::chrono::seconds(10);
    while (arrived < GetParam() && std::chrono::steady_clock::now() < limit)
      std::this_thread::yield();
    const std::lock_guard lock(mutex);
    seen.insert(std::this_thread::get_id());
  });
  EXPECT_EQ(seen.size(), static_cast<size_t>(GetParam()));
}

TEST_P(Parallel, NestedWorkRunsOnTheSameThread) {
  std::atomic<int> total{0};
  for_chunks(20, [&](int64_t) {
    const auto outer = std::this_thread::get_id();
    for_chunks(10, [&](int64_t) {
      EXPECT_EQ(std::this_thread::get_id(), outer);
      ++total;
    });
  });
  EXPECT_EQ(total, 200);
}

TEST_P(Parallel, AnExceptionOfABodyReachesTheCaller) {
  EXPECT_THROW(for_chunks(50,
                          [](int64_t chunk) {
                            if (chunk == 17) throw std::runtime_error("chunk 17");
                          }),
               std::runtime_error);
  std::atomic<int> total{0};
  for_chunks(50, [&](int64_t) { ++total; });
  EXPECT_EQ(total, 50);
}

TEST_P(Parallel, AChildProcessAfterForkWorksOnItsOneThread) {
  for_chunks(100, [](int64_t) {});  // the threads exist
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    alarm(20);  // a hang ends the child, not the test run
    int total = 0;
    const auto self = std::this_thread::get_id();
    for_chunks(100, [&](int64_t) { total += std::this_thread::get_id() == self ? 1 : 1000; });
    set_num_threads(3);
    for_chunks(100, [&](int64_t) { ++total; });
    _exit(total == 200 ? 0 : 1);
  }
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 0);
  std::atomic<int> total{0};
  for_chunks(100, [&](int64_t) { ++total; });
  EXPECT_EQ(total, 100) << "the parent goes on";
}

TEST_P(Parallel, WorkFromSeveralThreadsAtOnceIsDone) {
  std::atomic<int> total{0};
  std::vector<std::thread> threads;
  for (int t = 0; t < 3; ++t) {
    threads.emplace_back([&] {
      for (int k = 0; k < 20; ++k) for_chunks(30, [&](int64_t) { ++total; });
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(total, 3 * 20 * 30);
}

INSTANTIATE_TEST_SUITE_P(Threads, Parallel, ::testing::Values(1, 2, 7));

TEST(NumThreads, ComesFromTheEnvironmentAndABadValueIsAnError) {
  EXPECT_EQ(testing::probe("NOVAPHY_NUM_THREADS=7", "threads").output, "7\n");
  EXPECT_EQ(testing::probe("NOVAPHY_NUM_THREADS=", "threads").output,
            std::to_string(available_cpus()) + "\n");
  for (const char* bad : {"0", "-1", "x", "3x", "1025", "99999999999", "1.5", "' 2'"}) {
    const testing::Outcome result =
        testing::probe(std::string("NOVAPHY_NUM_THREADS=") + bad, "threads");
    EXPECT_EQ(result.code, 1) << bad;
    EXPECT_NE(result.output.find("NOVAPHY_NUM_THREADS: expected an integer from 1 to 1024, got"),
              std::string::npos)
        << result.output;
  }
}

TEST(NumThreads, MustBePositiveAndIsNotChangedFromInside) {
  EXPECT_THROW(set_num_threads(0), Error);
  EXPECT_THROW(set_num_threads(-3), Error);
  EXPECT_THROW(set_num_threads(1025), Error);
  const int before = num_threads();
  set_num_threads(2);
  EXPECT_THROW(for_chunks(4, [](int64_t) { set_num_threads(3); }), Error);
  EXPECT_EQ(num_threads(), 2);
  set_num_threads(before);
}

#if defined(__x86_64__)
TEST(FloatMode, IsSetWhileItLastsAndGivenBack) {
  const uint32_t before = _mm_getcsr();
  _mm_setcsr(before | 0x8040u | 0x2000u);  // flush to zero, denormals are zero, round down
  const uint32_t odd = _mm_getcsr();
  {
    const cpu::FloatMode mode;
    EXPECT_EQ(_mm_getcsr() & 0xFFC0u, 0x1F80u);
    volatile float tiny = 1e-40f;
    EXPECT_NE(tiny * 0.5f, 0.0f);
  }
  EXPECT_EQ(_mm_getcsr() & 0xFFC0u, odd & 0xFFC0u);
  _mm_setcsr(before);
}

TEST(FloatMode, WorkersComputeInTheContractsMode) {
  const int threads = num_threads();
  for (const int count : {1, 4}) {
    set_num_threads(count);
    const uint32_t before = _mm_getcsr();
    _mm_setcsr(before | 0x8040u | 0x6000u);
    std::atomic<int> wrong{0};
    for_chunks(64, [&](int64_t) { wrong += (_mm_getcsr() & 0xFFC0u) != 0x1F80u; });
    for_chunks(1, [&](int64_t) { wrong += (_mm_getcsr() & 0xFFC0u) != 0x1F80u; });
    _mm_setcsr(before);
    EXPECT_EQ(wrong, 0) << count;
  }
  set_num_threads(threads);
}
#endif

TEST(CheckInterrupt, AsksAtMostEveryFiftyMilliseconds) {
  using clock = std::chrono::steady_clock;
  int asked = 0;
  set_interrupt_check([&] { ++asked; });
  const auto start = clock::now();
  while (asked < 4 && clock::now() - start < std::chrono::seconds(10)) check_interrupt();
  const auto time = clock::now() - start;
  set_interrupt_check(nullptr);
  check_interrupt();
  EXPECT_EQ(asked, 4);
  EXPECT_GE(time, 3 * std::chrono::milliseconds(50));
}

TEST(CheckInterrupt, PassesOnWhatTheCheckThrows) {
  set_interrupt_check([] { throw Error(ErrorKind::Runtime, "stop"); });
  const auto run = [] {
    const auto start = std::chrono::steady_clock::now();
    while (std::chrono::steady_clock::now() - start < std::chrono::seconds(2)) check_interrupt();
  };
  EXPECT_THROW(run(), Error);
  set_interrupt_check(nullptr);
}

}  // namespace
}  // namespace novaphy
