// ThreadTeam: threads that run jobs, one after another. A job is a call of run(). The threads share
// its chunks. If jobs follow each other quickly, a start costs one write and one read, and no
// system call. Helper threads wait for the next job for a while before they return to oneTBB.
// Within a job, threads enter the next phase on their own when all chunks of the phase before it
// are done.
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

  // Calls work(context, chunk) for every chunk from `first` on, phase after phase; ends[p] is the
  // end of the chunks of phase p. Returns when all chunks are done, and rethrows an exception of a
  // chunk. Returns false without any work if another thread uses the team.
  bool run(int64_t first, std::span<const int64_t> ends, void (*work)(void*, int64_t),
           void* context);

 private:
  struct Shared;
  static void come(Shared& shared);
  static void help(Shared& shared, size_t member);

  const std::shared_ptr<Shared> shared_;  // shared with helpers, which may outlive the team
  tbb::global_control control_;  // raises oneTBB's limit of one thread per CPU, so that tests can
                                 // run 7 threads on 2 CPUs
  tbb::task_arena arena_;
};

}  // namespace novaphy
