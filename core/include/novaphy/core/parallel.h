// Threads. Work is cut into chunks whose number never depends on the number of threads, so results
// do not either. oneTBB runs them.
#pragma once

#include <cstdint>
#include <functional>
#include <span>

#include "novaphy/core/export.h"

namespace novaphy {

// The number of threads that parallel work uses: set_num_threads, else NOVAPHY_NUM_THREADS, else
// the CPUs that the affinity mask and the cgroup CPU limit leave to this process.
NOVAPHY_CORE_API int num_threads();
NOVAPHY_CORE_API void set_num_threads(
    int count);  // throws ErrorKind::Value unless 1 <= count <= 1024
// CPUs this process may use: the affinity mask, capped by the cgroup quota (v1 and v2), at least 1.
NOVAPHY_CORE_API int available_cpus();

// Calls body(context, chunk) for every chunk in [0, chunks) and returns when all are done. Nested
// calls and calls in a child process after fork run on the calling thread.
NOVAPHY_CORE_API void parallel_for(int64_t chunks, void (*body)(void*, int64_t), void* context);
// Whether parallel_for would call all chunks on this thread, as inside of a chunk.
NOVAPHY_CORE_API bool in_parallel();
// The same for the chunks of phases that follow one another: those from `first` to ends[0] are done
// before any of those to ends[1] begins. The threads meet between phases, which costs a fraction of
// a microsecond, instead of being called anew for each.
NOVAPHY_CORE_API void parallel_phases(int64_t first, std::span<const int64_t> ends,
                                      void (*body)(void*, int64_t), void* context);

// Long native loops call this between operations: the Python binding installs a check that raises
// KeyboardInterrupt. Cheap: looks at the clock, and asks at most every 50 ms.
NOVAPHY_CORE_API void check_interrupt();
NOVAPHY_CORE_API void set_interrupt_check(std::function<void()> check);

}  // namespace novaphy
