// Threads that share the chunks of one job after another. While jobs follow each other closely, a
// hand-over costs a write and a read, and no system call. The helpers watch for the next job for a
// while before they give their thread back to oneTBB. Threads go on to the next phase of a job by
// themselves, once the chunks of the phase are done.
#pragma once

#include <oneapi/tbb/global_control.h>
#include <oneapi/tbb/task_arena.h>

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

namespace novaphy {

class ThreadTeam {
 public:
  explicit ThreadTeam(int threads);
  ~ThreadTeam();

  // Calls work(context, chunk) for every chunk from `first` on, the phases one after another
  // (ends[p]: the end of the chunks of phase p), and returns when all are done; throws what one of
  // them threw. False, and nothing done, when another thread has the team.
  bool run(int64_t first, std::span<const int64_t> ends, void (*work)(void*, int64_t),
           void* context);

 private:
  struct Shared;
  static void come(Shared& shared);
  static void help(Shared& shared, size_t member);

  const std::shared_ptr<Shared> shared_;  // with the helpers, which may outlive the team
  tbb::global_control control_;  // lifts oneTBB's own limit, the CPUs: 7 threads are tested on 2
  tbb::task_arena arena_;
};

}  // namespace novaphy
