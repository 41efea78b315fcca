#include "novaphy/core/recorder.h"

#include <utility>

#include "novaphy/core/device_array.h"
#include "novaphy/core/launch_trace.h"

namespace novaphy {

namespace {
thread_local LaunchRecorder* t_recorder = nullptr;
}  // namespace

LaunchRecorder::~LaunchRecorder() = default;

LaunchRecorder* launch_recorder() { return t_recorder; }
LaunchRecorder* set_launch_recorder(LaunchRecorder* recorder) {
  return std::exchange(t_recorder, recorder);
}

void depend_on(std::span<const Array* const> arrays) {
  if (t_recorder == nullptr) return;
  for (const Array* array : arrays)
    if (array->range()) t_recorder->depends_on(array->range());
}

void submit_launch(const Launch& launch) {
  if (t_recorder != nullptr) return t_recorder->launch(launch);
  launch_now(launch.context, launch.kernel, launch.name, launch.n, launch.words);
  for (const LaunchArgument& argument : launch.arguments)
    if (argument.write && argument.range) argument.range->mark_written();
}

namespace {

[[gnu::always_inline]] inline void run_launch(const DeviceContext& context, novaphy_kernel* kernel,
                                              const char* name, int64_t n,
                                              std::span<const uint64_t> words) {
  novaphy_error error = make_error();
  const novaphy_status status = context.api->launch(context.stream, kernel, n, words.data(),
                                                    static_cast<uint32_t>(words.size()), &error);
  if (status != NOVAPHY_OK) [[unlikely]]
    check(status, error, name);
}

// A separate function, so that launch_now needs no stack frame when tracing is off.
[[gnu::noinline]] void run_as_event(const DeviceContext& context, novaphy_kernel* kernel,
                                    const char* name, int64_t n, std::span<const uint64_t> words) {
  traced_launch(context, name, n, [&] { run_launch(context, kernel, name, n, words); });
}

}  // namespace

void launch_now(const DeviceContext& context, novaphy_kernel* kernel, const char* name, int64_t n,
                std::span<const uint64_t> words) {
  if (detail::launches_are_traced) [[unlikely]]
    return run_as_event(context, kernel, name, n, words);
  run_launch(context, kernel, name, n, words);
}

}  // namespace novaphy
