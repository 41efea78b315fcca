#include "thread_team.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <exception>
#include <mutex>
#include <thread>
#include <utility>
#include <vector>

#if defined(__x86_64__)
#include <immintrin.h>
#endif

namespace novaphy {
namespace {

constexpr auto kWatch = std::chrono::microseconds(100);  // how long helpers wait for the next job
constexpr auto kLeave = std::chrono::seconds(1);
constexpr int kSpins = 256;     // spins between two reads of the clock
constexpr int kPatience = 16;   // spins before stealing, some tenths of a microsecond
constexpr size_t kApart = 128;  // bytes; processors fetch cache lines in pairs

void relax() {
#if defined(__x86_64__)
  _mm_pause();
#elif defined(__aarch64__)
  __asm__ volatile("yield");
#endif
}

// Returns the largest number of chunks in a phase.
int64_t most_chunks(int64_t first, std::span<const int64_t> ends) {
  int64_t most = 0;
  for (const int64_t end : ends) most = std::max(most, end - std::exchange(first, end));
  return most;
}

}  // namespace

struct ThreadTeam::Shared {
  // The chunks of one member in the current phase. Each member starts with its own part, which is
  // the same in every phase with the same number of chunks: data that the member wrote is then
  // still in its cache. Afterwards the member steals chunks from other parts. `taken` packs the
  // phase and the number of chunks taken in this phase into one word.
  struct alignas(kApart) Part {
    std::atomic<uint64_t> taken{0};
    // Takes the next of the part's `count` chunks in the phase, if one is left. A member enters a
    // phase only after all chunks of earlier phases are done.
    bool take(uint64_t phase, int64_t count, int64_t& chunk) {
      uint64_t known = taken.load(std::memory_order_relaxed);
      do {
        chunk = known >> 32 == phase ? static_cast<int64_t>(known & 0xFFFFFFFF) : 0;
        if (known >> 32 > phase || chunk == count) return false;
      } while (!taken.compare_exchange_weak(known, phase << 32 | static_cast<uint64_t>(chunk + 1),
                                            std::memory_order_relaxed));
      return true;
    }
  };

  // The state of one thread in the team; the calling thread has the first seat. The number of
  // finished chunks is the sum over all seats. One shared counter would move between caches at the
  // end of every phase.
  struct alignas(kApart) Seat {
    std::atomic<int64_t> done{0};  // written by its member only
    std::atomic<bool> held{false};
  };

  explicit Shared(int count)
      : threads(count), parts(static_cast<size_t>(count)), seats(static_cast<size_t>(count)) {}

  const int threads;
  std::atomic_flag taken = ATOMIC_FLAG_INIT;  // held by the thread that owns the job
  // The job and its number. The caller writes the job while `number` is even. Members that enter
  // while `number` is odd read the job.
  alignas(64) std::atomic<uint64_t> number{0};
  void (*work)(void*, int64_t) = nullptr;
  void* context = nullptr;
  int64_t first = 0;
  std::span<const int64_t> ends;
  size_t used_parts = 0;
  std::vector<Part> parts;
  std::vector<Seat> seats;
  std::mutex mutex;
  std::exception_ptr failure;
  std::atomic<bool> failed{false};         // whether the remaining chunks are skipped
  alignas(64) std::atomic<int> inside{0};  // number of helper threads inside of the job
  std::atomic<int> helpers{0};             // helpers that wait for jobs or have been called
  std::atomic<bool> stop{false};

  // Returns the number of finished chunks, counted from `first`. A phase begins when all chunks of
  // the phases before it are done.
  int64_t done() const {
    int64_t sum = first;
    for (const Seat& seat : seats) sum += seat.done.load(std::memory_order_acquire);
    return sum;
  }
  void do_chunk(int64_t chunk) {
    if (failed.load(std::memory_order_relaxed)) return;
    try {
      work(context, chunk);
    } catch (...) {
      const std::lock_guard lock(mutex);
      failure = std::current_exception();
      failed = true;
    }
  }
  // Runs the remaining chunks of part `part` in phase `phase`, which has the chunks [begin, end).
  void do_part(size_t member, size_t part, uint64_t phase, int64_t begin, int64_t end) {
    const auto parts_count = static_cast<int64_t>(used_parts);
    const auto share = [&](size_t k) {  // the first parts get the remainder of the division
      return begin + (static_cast<int64_t>(k) * (end - begin) + parts_count - 1) / parts_count;
    };
    const int64_t from = share(part), chunks = share(part + 1) - from;
    int64_t count = 0, chunk = 0;
    for (; parts[part].take(phase, chunks, chunk); ++count) do_chunk(from + chunk);
    std::atomic<int64_t>& mine = seats[member].done;
    if (count != 0)
      mine.store(mine.load(std::memory_order_relaxed) + count, std::memory_order_release);
  }
  // Members usually finish a phase at about the same time. An early member spins before it steals
  // chunks, because stealing moves their data out of the caches of other members.
  void do_phase(size_t member, uint64_t phase, int64_t begin, int64_t end) {
    do_part(member, member % used_parts, phase, begin, end);
    for (int k = 0; done() < end; k = std::min(k + 1, kSpins)) {
      if (k == kPatience)
        for (size_t p = 1; p < used_parts; ++p)
          do_part(member, (member + p) % used_parts, phase, begin, end);
      k < kSpins ? relax() : std::this_thread::yield();
    }
  }
  void do_share(size_t member) {
    // A late helper skips the phases that are done.
    for (auto end = std::upper_bound(ends.begin(), ends.end(), done()); end != ends.end(); ++end) {
      const auto phase = static_cast<uint64_t>(end - ends.begin());
      do_phase(member, phase, phase == 0 ? first : end[-1], *end);
    }
  }
  // Joins the job with the number `job`, unless the job is over.
  void enter(uint64_t job, size_t member) {
    ++inside;
    if (number == job) do_share(member);
    --inside;
  }
  // Takes a free seat and returns its index. Returns the number of seats if all are taken.
  size_t take_seat() {
    size_t k = 1;
    while (k < seats.size() && seats[k].held.exchange(true)) ++k;
    return k;
  }
  bool open(uint64_t job, uint64_t last) const { return job % 2 == 1 && job != last; }
};

ThreadTeam::ThreadTeam(int threads)
    : shared_(std::make_shared<Shared>(threads)),
      control_(tbb::global_control::max_allowed_parallelism, static_cast<size_t>(threads)),
      arena_(threads) {}
// Helpers that were called but have not arrived yet still use the shared data. The destructor gives
// them time to leave.
ThreadTeam::~ThreadTeam() {
  shared_->stop = true;
  const auto until = std::chrono::steady_clock::now() + kLeave;
  while (shared_->helpers != 0 && std::chrono::steady_clock::now() < until)
    std::this_thread::yield();
}

void ThreadTeam::come(Shared& s) {
  const size_t member = s.take_seat();
  if (member < s.seats.size()) {
    help(s, member);
    s.seats[member].held = false;
  } else {  // a helper that was about to leave and is no longer counted
    --s.helpers;
  }
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
    // A job that began in the meantime may still count this helper.
    --s.helpers;
    if (!s.open(s.number, done)) return;
    ++s.helpers;
  }
  --s.helpers;
}

bool ThreadTeam::run(int64_t first, std::span<const int64_t> ends, void (*work)(void*, int64_t),
                     void* context) {
  Shared& s = *shared_;
  if (s.taken.test_and_set()) return false;
  s.work = work;
  s.context = context;
  s.failure = nullptr;
  s.failed = false;
  s.first = first;
  s.ends = ends;
  for (Shared::Seat& seat : s.seats) seat.done.store(0, std::memory_order_relaxed);
  s.used_parts = static_cast<size_t>(std::min<int64_t>(s.threads, most_chunks(first, ends)));
  const auto parts = static_cast<int>(s.used_parts);
  for (int k = 0; k < parts; ++k) s.parts[static_cast<size_t>(k)].taken = 0;
  ++s.number;
  while (s.helpers < parts - 1) {
    ++s.helpers;
    try {
      arena_.enqueue([shared = shared_] { come(*shared); });
    } catch (...) {  // out of memory: the present members do the work
      --s.helpers;
      break;
    }
  }
  s.do_share(0);
  ++s.number;
  for (int k = 0; s.inside != 0; k = std::min(k + 1, kSpins))
    k < kSpins ? relax() : std::this_thread::yield();
  const std::exception_ptr failure = std::move(s.failure);
  s.taken.clear();
  if (failure) std::rethrow_exception(failure);
  return true;
}

}  // namespace novaphy
