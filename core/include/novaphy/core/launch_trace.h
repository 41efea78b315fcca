// The hook in every launch. NOVAPHY_TRACE (docs/environment.md) makes launches events of a trace
// file, or ranges of a profiler.
#pragma once

#include <cstdint>

#include "novaphy/core/backend.h"
#include "novaphy/core/export.h"

namespace novaphy {

namespace detail {

// Whether NOVAPHY_TRACE is set; it is read when the first device is opened, before any launch.
extern NOVAPHY_CORE_API bool launches_are_traced;

// An event that lasts as long as the object.
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

// What `run` returns, which hands a launch over those rows to a backend. The event of a device
// lasts as long as that takes; its rows may be computed later.
template <class Run>
auto traced_launch(const DeviceContext& context, const char* name, int64_t rows, const Run& run) {
  if (!detail::launches_are_traced) [[likely]]
    return run();
  const detail::LaunchEvent event(context, name, rows);
  return run();
}

}  // namespace novaphy
