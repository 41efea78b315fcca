// Parallel loops on threads of oneTBB. Work is cut into chunks whose number never depends on the
// number of threads. Results therefore do not depend on the number of threads either.
#pragma once

#include <cstdint>
#include <functional>
#include <span>

#include "novaphy/core/export.h"

namespace novaphy {

// Returns the number of threads for parallel work: the value given to set_num_threads, else
// NOVAPHY_NUM_THREADS, else available_cpus().
NOVAPHY_CORE_API int num_threads();
NOVAPHY_CORE_API void set_num_threads(
    int count);  // throws ErrorKind::Value unless 1 <= count <= 1024
// Returns the number of CPUs that this process may use: the affinity mask, capped by the cgroup
// quota (v1 and v2), at least 1.
NOVAPHY_CORE_API int available_cpus();

// Calls body(context, chunk) for every chunk in [0, chunks) and returns when all chunks are done. A
// nested call runs on the calling thread. So does a call in a child process after fork.
NOVAPHY_CORE_API void parallel_for(int64_t chunks, void (*body)(void*, int64_t), void* context);
// Returns whether parallel_for would run all chunks on this thread, as in a call from a chunk.
NOVAPHY_CORE_API bool in_parallel();
// Runs the chunks of several phases in order. The chunks from `first` to ends[0] finish before a
// chunk from ends[0] to ends[1] begins, and so on. The threads stay awake between phases and meet
// at a barrier, which costs a fraction of a microsecond.
NOVAPHY_CORE_API void parallel_phases(int64_t first, std::span<const int64_t> ends,
                                      void (*body)(void*, int64_t), void* context);

// Long native loops call this function between operations. The Python binding installs a check that
// raises KeyboardInterrupt. The check runs at most once in 50 ms. Calls in between only read the
// clock.
NOVAPHY_CORE_API void check_interrupt();
NOVAPHY_CORE_API void set_interrupt_check(std::function<void()> check);

}  // namespace novaphy
