// The backend's own kernels, for the fake driver.
#pragma once

#include <functional>

struct HostKernel {
  const char* name;
  bool waits;  // threads of a block wait for each other
  // One thread, with a copy of the arguments as passed to the driver.
  std::function<void()> (*bind)(void* const* arguments);
};
// Null: no kernel has this name.
const HostKernel* find_host_kernel(const char* name);
// Runs a launch. Only one launch may run at a time. `backwards`: threads run from the last row to
// the first.
void run_host_kernel(const HostKernel& kernel, unsigned blocks, unsigned threads, bool backwards,
                     const std::function<void()>& thread);
