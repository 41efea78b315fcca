// Runs native code over the rows of a launch, in the same chunks as the interpreter.
#include <algorithm>

#include "module.h"
#include "novaphy/cpu/float_mode.h"

namespace novaphy::cpu {
namespace {

struct Launch {
  const Executable* executable;
  const uint64_t* arguments;
  ErrorSink* sink;
  int64_t n;
};

void run_rows(const Launch& launch, int64_t begin, int64_t end) {
  const NativeCode& code = launch.executable->native;
  int64_t done = begin;
  if (end - begin >= code.lanes) done = code.rows(launch.arguments, begin, end, launch.sink);
  if (done < end) done = code.scalar(launch.arguments, done, end, launch.sink);
  // Only where a source has fewer rows than the launch: the interpreter knows which lanes need
  // them.
  if (done < end) [[unlikely]]
    interpret_rows(*launch.executable, done, end, launch.arguments, *launch.sink);
}

void run_chunk(void* opaque, int64_t chunk) {
  const Launch& launch = *static_cast<const Launch*>(opaque);
  const FloatMode mode;
  const int64_t begin = chunk * kChunkRows;
  run_rows(launch, begin, std::min(launch.n, begin + kChunkRows));
}

}  // namespace

void run_native(const Executable& executable, const novaphy_host_api& host, int64_t n,
                const uint64_t* arguments, ErrorSink& sink) {
  Launch launch{&executable, arguments, &sink, n};
  if (n <= kChunkRows) {
    run_rows(launch, 0, n);
  } else {
    host.parallel_for((n + kChunkRows - 1) / kChunkRows, run_chunk, &launch);
  }
}

}  // namespace novaphy::cpu
