// The backend's own kernels, for the fake driver.
#pragma once

struct HostKernel {
  const char* name;
  void (*call)(void* const* arguments);  // one thread
};
// Null: there is none of this name.
const HostKernel* find_host_kernel(const char* name);
// One at a time; `arguments` as the driver gets them.
void run_host_kernel(const HostKernel& kernel, unsigned blocks, unsigned threads,
                     void* const* arguments);
