#include "thread_team.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace novaphy {
namespace {

constexpr auto kWatch = std::chrono::microseconds(100);  // for the next job
constexpr auto kLeave = std::chrono::seconds(1);
constexpr int kSpins = 256;  // between two looks at the clock

void relax() {
#if defined(__x86_64__)
  _mm_pause();
#elif defined(__aarch64__)
  __asm__ volatile("yield");
#endif
}

}  // namespace

struct ThreadTeam::Shared {
  // Each member begins with a part of its own, the same in every job of as many chunks, so that
  // what it wrote is still in its cache; then it takes what the others have not come to.
  struct alignas(64) Part {
    std::atomic<int64_t> next{0};
    int64_t end = 0;
  };

  explicit Shared(int count) : threads(count), parts(static_cast<size_t>(count)) {}

  const int threads;
  std::atomic_flag taken = ATOMIC_FLAG_INIT;  // by the thread whose job it is
  // The job: written while `number` is even, read by those who entered while it was odd.
  alignas(64) std::atomic<uint64_t> number{0};
  void (*work)(void*, int64_t) = nullptr;
  void* context = nullptr;
  size_t used_parts = 0;
  std::vector<Part> parts;
  std::mutex mutex;
  std::exception_ptr failure;
  alignas(64) std::atomic<int> inside{0};  // helpers in the job
  std::atomic<int> helpers{0};             // that watch, or have been called
  std::atomic<bool> stop{false};

  void do_chunks(size_t member) {
    try {
      for (size_t k = 0; k < used_parts; ++k) {
        Part& part = parts[(member + k) % used_parts];
        for (int64_t chunk = part.next++; chunk < part.end; chunk = part.next++)
          work(context, chunk);
      }
    } catch (...) {
      const std::lock_guard lock(mutex);
      failure = std::current_exception();
      for (Part& part : parts) part.next = part.end;
    }
  }
  // Does a share of the job of that number, unless it is over.
  void enter(uint64_t job, size_t member) {
    ++inside;
    if (number == job) do_chunks(member);
    --inside;
  }
  bool open(uint64_t job, uint64_t done) const { return job % 2 == 1 && job != done; }
};

ThreadTeam::ThreadTeam(int threads)
    : shared_(std::make_shared<Shared>(threads)),
      control_(tbb::global_control::max_allowed_parallelism, static_cast<size_t>(threads)),
      arena_(threads) {}
// Helpers that were called and have not come yet hold on to what is shared: they are given time to.
ThreadTeam::~ThreadTeam() {
  shared_->stop = true;
  const auto until = std::chrono::steady_clock::now() + kLeave;
  while (shared_->helpers != 0 && std::chrono::steady_clock::now() < until)
    std::this_thread::yield();
}

void ThreadTeam::help(Shared& s, size_t member) {
  using Clock = std::chrono::steady_clock;
  uint64_t done = 0;
  auto until = Clock::now() + kWatch;
  while (!s.stop) {
    const uint64_t job = s.number;
    if (s.open(job, done)) {
      s.enter(job, member);
      done = job;
      until = Clock::now() + kWatch;
      continue;
    }
    for (int k = 0; k < kSpins && s.number == job; ++k) relax();
    if (s.number != job || Clock::now() < until) continue;
    // A job that began meanwhile may have counted on this helper.
    --s.helpers;
    if (!s.open(s.number, done)) return;
    ++s.helpers;
  }
  --s.helpers;
}

bool ThreadTeam::run(int64_t chunks, void (*work)(void*, int64_t), void* context) {
  Shared& s = *shared_;
  if (s.taken.test_and_set()) return false;
  s.work = work;
  s.context = context;
  s.failure = nullptr;
  s.used_parts = static_cast<size_t>(std::min<int64_t>(s.threads, chunks));
  const auto parts = static_cast<int64_t>(s.used_parts);
  for (int64_t k = 0; k < parts; ++k) {
    s.parts[static_cast<size_t>(k)].next = k * chunks / parts;
    s.parts[static_cast<size_t>(k)].end = (k + 1) * chunks / parts;
  }
  ++s.number;
  while (s.helpers < static_cast<int>(parts) - 1) {
    const auto member = static_cast<size_t>(++s.helpers);
    try {
      arena_.enqueue([shared = shared_, member] { help(*shared, member); });
    } catch (...) {  // out of memory: those who are there do it
      --s.helpers;
      break;
    }
  }
  s.do_chunks(0);
  ++s.number;
  for (int k = 0; s.inside != 0; ++k) k < kSpins ? relax() : std::this_thread::yield();
  const std::exception_ptr failure = std::move(s.failure);
  s.taken.clear();
  if (failure) std::rethrow_exception(failure);
  return true;
}

}  // namespace novaphy
