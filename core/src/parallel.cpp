#include "novaphy/core/parallel.h"

#include <pthread.h>
#include <time.h>

#include <algorithm>
#include <atomic>
#include <charconv>
#include <cstdlib>
#include <cstring>
#include <exception>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include "cpu_limits.h"
#include "novaphy/core/error.h"
#include "novaphy/cpu/float_mode.h"
#include "thread_team.h"

#if defined(__SANITIZE_THREAD__)
#define NOVAPHY_THREAD_SANITIZER 1
#elif defined(__has_feature)
#define NOVAPHY_THREAD_SANITIZER __has_feature(thread_sanitizer)
#else
#define NOVAPHY_THREAD_SANITIZER 0
#endif

namespace novaphy {
namespace {

constexpr int kMaxThreads = 1024;

struct State {
  std::mutex mutex;
  std::shared_ptr<ThreadTeam> workers;  // null until the first parallel work
};

// Never destroyed, because at exit and in a child process the threads may already be gone.
State& state() {
  static State* state = new State;
  return *state;
}

std::atomic<int> g_threads{0};        // 0: not determined yet
std::atomic<bool> g_in_child{false};  // a child process after fork has no worker threads
thread_local bool t_inside = false;   // whether this thread runs a chunk, so that nested work is
                                      // serial

int threads_from_environment() {
  const char* text = std::getenv("NOVAPHY_NUM_THREADS");
  if (text == nullptr || *text == '\0') return std::min(available_cpus(), kMaxThreads);
  int count = 0;
  const char* end = text + std::strlen(text);
  const auto [stop, code] = std::from_chars(text, end, count);
  require(code == std::errc() && stop == end && count >= 1 && count <= kMaxThreads,
          ErrorKind::Value, "NOVAPHY_NUM_THREADS: expected an integer from 1 to ", kMaxThreads,
          ", got \"", text, "\"");
  return count;
}

std::shared_ptr<ThreadTeam> workers(int threads) {
  State& s = state();
  const std::lock_guard lock(s.mutex);
  if (s.workers == nullptr) {
    static const int registered = pthread_atfork(nullptr, nullptr, [] { g_in_child.store(true); });
    static_cast<void>(registered);
    s.workers = std::make_shared<ThreadTeam>(threads);
  }
  return s.workers;
}

void run_serially(int64_t first, int64_t end, void (*body)(void*, int64_t), void* context) {
  const cpu::FloatMode mode;
  for (int64_t chunk = first; chunk < end; ++chunk) body(context, chunk);
}

struct InsideGuard {
  const bool before = t_inside;
  InsideGuard() { t_inside = true; }
  ~InsideGuard() { t_inside = before; }
};

#if NOVAPHY_THREAD_SANITIZER
// The oneTBB library is not built with the thread sanitizer, which would report its synchronization
// as races. Under the sanitizer plain threads run the chunks instead, so that the loop bodies are
// checked.
void run_phase(int threads, int64_t first, int64_t end, void (*body)(void*, int64_t),
               void* context) {
  std::atomic<int64_t> next{first};
  std::mutex mutex;
  std::exception_ptr failure;
  const auto work = [&] {
    const InsideGuard inside;
    const cpu::FloatMode mode;
    try {
      for (int64_t chunk = next++; chunk < end; chunk = next++) body(context, chunk);
    } catch (...) {
      const std::lock_guard lock(mutex);
      failure = std::current_exception();
    }
  };
  std::vector<std::thread> team;
  for (int k = 1; k < threads; ++k) team.emplace_back(work);
  work();
  for (std::thread& thread : team) thread.join();
  if (failure) std::rethrow_exception(failure);
}
void run_on_threads(int threads, int64_t first, std::span<const int64_t> ends,
                    void (*body)(void*, int64_t), void* context) {
  workers(threads);  // starts the handler of fork
  for (const int64_t end : ends) {
    run_phase(threads, first, end, body, context);
    first = end;
  }
}
#else
void run_on_threads(int threads, int64_t first, std::span<const int64_t> ends,
                    void (*body)(void*, int64_t), void* context) {
  struct Work {
    void (*body)(void*, int64_t);
    void* context;
  } work{body, context};
  const auto run = [](void* opaque, int64_t chunk) {
    const Work& w = *static_cast<const Work*>(opaque);
    const InsideGuard inside;
    const cpu::FloatMode mode;
    w.body(w.context, chunk);
  };
  // If another thread uses the team, this thread runs its own chunks alone.
  if (!workers(threads)->run(first, ends, run, &work))
    run_serially(first, ends.back(), body, context);
}
#endif

}  // namespace

int available_cpus() {
  const int cpus = affinity_cpus();
  const int limit = cgroup_cpu_limit("/");
  return std::max(1, limit > 0 ? std::min(cpus, limit) : cpus);
}

int num_threads() {
  int count = g_threads.load(std::memory_order_relaxed);
  if (count != 0) return count;
  const int wanted = threads_from_environment();
  g_threads.compare_exchange_strong(count, wanted);
  return g_threads.load();
}

void set_num_threads(int count) {
  require(count >= 1 && count <= kMaxThreads, ErrorKind::Value, "set_num_threads: expected 1 to ",
          kMaxThreads, ", got ", count);
  require(!t_inside, ErrorKind::Runtime, "set_num_threads: called from inside parallel work");
  g_threads.store(count);
  if (g_in_child.load()) return;
  State& s = state();
  std::shared_ptr<ThreadTeam>
      old;  // destroyed outside of the lock; running work keeps it alive
  const std::lock_guard lock(s.mutex);
  old.swap(s.workers);
}

bool in_parallel() {
  return t_inside || g_in_child.load(std::memory_order_relaxed) || num_threads() == 1;
}

void parallel_for(int64_t chunks, void (*body)(void*, int64_t), void* context) {
  if (chunks > 0) parallel_phases(0, {&chunks, 1}, body, context);
}

void parallel_phases(int64_t first, std::span<const int64_t> ends, void (*body)(void*, int64_t),
                     void* context) {
  if (ends.empty()) return;
  const int64_t chunks = ends.back() - first;
  const bool alone = chunks <= 1 || t_inside || g_in_child.load(std::memory_order_relaxed);
  const int threads = alone ? 1 : num_threads();
  if (threads == 1) return run_serially(first, ends.back(), body, context);
  run_on_threads(threads, first, ends, body, context);
}

namespace {

std::atomic<bool> g_has_check{false};
std::atomic<int64_t> g_next_check{0};
std::mutex g_check_mutex;
std::shared_ptr<const std::function<void()>> g_check;

}  // namespace

void set_interrupt_check(std::function<void()> check) {
  const std::lock_guard lock(g_check_mutex);
  g_has_check.store(static_cast<bool>(check));
  g_check = check ? std::make_shared<const std::function<void()>>(std::move(check)) : nullptr;
}

void check_interrupt() {
  if (!g_has_check.load(std::memory_order_relaxed)) return;
  // The coarse clock costs a few nanoseconds and has a resolution of 4 ms.
  timespec time{};
  clock_gettime(CLOCK_MONOTONIC_COARSE, &time);
  const int64_t now = static_cast<int64_t>(time.tv_sec) * 1'000'000'000 + time.tv_nsec;
  int64_t next = g_next_check.load(std::memory_order_relaxed);
  if (now < next || !g_next_check.compare_exchange_strong(next, now + 50'000'000)) return;
  std::shared_ptr<const std::function<void()>> check;
  {
    const std::lock_guard lock(g_check_mutex);
    check = g_check;
  }
  if (check != nullptr) (*check)();
}

}  // namespace novaphy
