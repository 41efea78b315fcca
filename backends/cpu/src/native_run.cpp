// Runs native code over the rows of a launch.
#include <algorithm>

#include "module.h"
#include "novaphy/cpu/float_mode.h"

namespace novaphy::cpu {
namespace {

struct Launch {
  const Executable* executable;
  const uint64_t* arguments;
  ErrorSink* sink;
  int64_t n, chunk_rows;
};

// Returns the number of operations per row. Each item of a sum adds the operations of the row
// again.
double operations_per_row(const Executable& executable, int64_t n, const uint64_t* arguments) {
  const nova::ir::Program& p = executable.program;
  double times = 1.0;
  for (size_t l = 0; l < p.loops.size(); ++l) {
    if (p.loops[l].kind == nova::ir::LoopKind::Csr) {
      const auto* offsets = reinterpret_cast<const int32_t*>(arguments[p.loop_argument(l)]);
      times += static_cast<double>(offsets[n] - offsets[0]) / static_cast<double>(n);
    } else {
      const auto extent = static_cast<size_t>(p.loops[l].extent_param);
      times += std::max(0, static_cast<int32_t>(arguments[p.param_argument(extent)]));
    }
  }
  return times * executable.operations;
}

// Returns the rows per chunk. A chunk takes at least about a microsecond, so that it is worth
// handing to another thread. Many chunks get more rows each, of about equal size.
int64_t chunk_rows(const Executable& executable, int64_t n, const uint64_t* arguments) {
  constexpr double kOperations = 1 << 16;
  constexpr int64_t kStep = 64, kManyChunks = 256;  // kStep is a multiple of the size of every lane
                                                    // group
  const double rows = kOperations / operations_per_row(executable, n, arguments);
  const int64_t most =
      std::clamp(std::max(static_cast<int64_t>(rows), n / kManyChunks), kStep, kChunkRows);
  const int64_t chunks = (n + most - 1) / most;
  return ((n + chunks - 1) / chunks + kStep - 1) / kStep * kStep;
}

// Marks the upper parts of vector registers as unused. Kernels of GCC at -O1 do not, and the SSE code
// after such a kernel is up to three times slower.
void leave_vectors([[maybe_unused]] const NativeCode& code) {
#if defined(__x86_64__)
  constexpr int64_t kSseLanes = 4;
  if (code.lanes > kSseLanes) __asm__ volatile("vzeroupper");
#endif
}

void run_chunk(void* opaque, int64_t chunk) {
  const Launch& launch = *static_cast<const Launch*>(opaque);
  const FloatMode mode;
  const int64_t begin = chunk * launch.chunk_rows;
  run_native_rows(*launch.executable, launch.arguments, begin,
                  std::min(launch.n, begin + launch.chunk_rows), *launch.sink);
}

}  // namespace

void run_native_rows(const Executable& executable, const uint64_t* arguments, int64_t begin,
                     int64_t end, ErrorSink& sink) {
  const NativeCode& code = executable.native;
  int64_t done = begin;
  if (end - begin >= code.lanes) {
    done = code.rows(arguments, begin, end, &sink);
    leave_vectors(code);
  }
  if (done < end) done = code.scalar(arguments, done, end, &sink);
  // The native code leaves rows only if a source has fewer rows than the launch. The interpreter
  // decides which lanes read such a row.
  if (done < end) [[unlikely]]
    interpret_rows(executable, done, end, arguments, sink);
}

void run_native(const Executable& executable, const novaphy_host_api& host, int64_t n,
                const uint64_t* arguments, ErrorSink& sink) {
  constexpr int64_t kFew = 128;  // too few rows to estimate their cost
  const bool whole = n <= kFew || (host.in_parallel != nullptr && host.in_parallel() != 0);
  const int64_t rows = whole ? n : chunk_rows(executable, n, arguments);
  if (n <= rows) {
    run_native_rows(executable, arguments, 0, n, sink);
  } else {
    Launch launch{&executable, arguments, &sink, n, rows};
    host.parallel_for((n + rows - 1) / rows, run_chunk, &launch);
  }
}

}  // namespace novaphy::cpu
