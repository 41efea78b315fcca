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

void run_chunk(void* opaque, int64_t chunk) {
  const Launch& launch = *static_cast<const Launch*>(opaque);
  const FloatMode mode;
  const int64_t begin = chunk * kChunkRows;
  run_native_rows(*launch.executable, launch.arguments, begin,
                  std::min(launch.n, begin + kChunkRows), *launch.sink);
}

}  // namespace

void run_native_rows(const Executable& executable, const uint64_t* arguments, int64_t begin,
                     int64_t end, ErrorSink& sink) {
  const NativeCode& code = executable.native;
  int64_t done = begin;
  if (end - begin >= code.lanes) done = code.rows(arguments, begin, end, &sink);
  if (done < end) done = code.scalar(arguments, done, end, &sink);
  // Only where a source has fewer rows than the launch: the interpreter knows which lanes need
  // them.
  if (done < end) [[unlikely]]
    interpret_rows(executable, done, end, arguments, sink);
}

void run_native(const Executable& executable, const novaphy_host_api& host, int64_t n,
                const uint64_t* arguments, ErrorSink& sink) {
  if (n <= kChunkRows) {
    run_native_rows(executable, arguments, 0, n, sink);
  } else {
    Launch launch{&executable, arguments, &sink, n};
    host.parallel_for((n + kChunkRows - 1) / kChunkRows, run_chunk, &launch);
  }
}

}  // namespace novaphy::cpu
