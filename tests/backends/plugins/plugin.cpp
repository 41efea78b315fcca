// The source of all plugins in the tests of the backend registry. Each plugin is correct except for
// the fault that its macro definition selects.
#include <cstddef>
#include <cstdio>

#include "novaphy/cpu/query.h"

namespace {

// The CPU backend's functions under another name.
[[maybe_unused]] const novaphy_backend_api* copy_of_cpu(uint32_t host_abi_major,
                                                        const novaphy_host_api* host,
                                                        novaphy_error* error,
                                                        novaphy_backend_api& table) {
  const novaphy_backend_api* cpu = novaphy_cpu_backend_query(host_abi_major, host, error);
  if (cpu == nullptr) return nullptr;
  table = *cpu;
  table.version = "1.2.3";
  return &table;
}

[[maybe_unused]] novaphy_backend_api g_table;

[[maybe_unused]] novaphy_status no_devices(int32_t* count, novaphy_error* error) {
  *count = 0;
  std::snprintf(error->message, sizeof(error->message), "no driver found");
  return NOVAPHY_OK;
}

[[maybe_unused]] novaphy_status begin(novaphy_stream*, novaphy_error*) {
  return NOVAPHY_NOT_SUPPORTED;
}

}  // namespace

#ifndef PLUGIN_NO_SYMBOL
extern "C" __attribute__((visibility("default"))) const novaphy_backend_api* novaphy_backend_query(
    uint32_t host_abi_major, const novaphy_host_api* host, novaphy_error* error) {
#ifdef PLUGIN_NULL_WITH_REASON
  (void)host_abi_major;
  (void)host;
  std::snprintf(error->message, sizeof(error->message), "this machine has too few vector units");
  return nullptr;
#else
  if (copy_of_cpu(host_abi_major, host, error, g_table) == nullptr) return nullptr;
  g_table.name = "cpu";
#ifdef PLUGIN_WRONG_MAJOR
  g_table.abi_major = NOVAPHY_ABI_MAJOR + 1;
#endif
#ifdef PLUGIN_SHORT_TABLE
  g_table.struct_size = offsetof(novaphy_backend_api, launch);
#endif
#ifdef PLUGIN_MISSING_FUNCTION
  g_table.memory_fill = nullptr;
#endif
#ifdef PLUGIN_HALF_CAPTURE
  g_table.capture_begin = begin;
#endif
#ifdef PLUGIN_UNKNOWN_TYPE
  g_table.device_type = 77;
#endif
#ifdef PLUGIN_NO_DEVICE
  g_table.name = "cuda";
  g_table.device_type = NOVAPHY_DEVICE_CUDA;
  g_table.device_count = no_devices;
#endif
  return &g_table;
#endif
}
#endif
