// Tracing of launches. With NOVAPHY_TRACE (docs/environment.md) every launch becomes an event of a
// trace file or a range of a profiler.
#pragma once

#include <cstdint>

#include "novaphy/core/backend.h"
#include "novaphy/core/export.h"

namespace novaphy {

namespace detail {

// Whether NOVAPHY_TRACE is set. The variable is read before the first launch, when the first device
// is opened.
extern NOVAPHY_CORE_API bool launches_are_traced;

// A trace event that lasts from the constructor to the destructor.
class NOVAPHY_CORE_API LaunchEvent {
 public:
  LaunchEvent(const DeviceContext& context, const char* name, int64_t rows);
  ~LaunchEvent();
  LaunchEvent(const LaunchEvent&) = delete;
  LaunchEvent& operator=(const LaunchEvent&) = delete;

 private:
  const DeviceContext& context_;
  const char* name_;
  int64_t rows_, begin_;
};

}  // namespace detail

// Calls `run`, which hands a launch over `rows` rows to a backend, and returns its result. The
// event lasts as long as the call. A device may compute the rows later.
template <class Run>
auto traced_launch(const DeviceContext& context, const char* name, int64_t rows, const Run& run) {
  if (!detail::launches_are_traced) [[likely]]
    return run();
  const detail::LaunchEvent event(context, name, rows);
  return run();
}

}  // namespace novaphy
