// What distinguishes the vendors whose drivers look like CUDA's; defined by the plugin.
#pragma once

#include "driver.h"

namespace novaphy::gpu {

struct VendorInfo {
  const char* name;                 // of the backend and its devices: "cuda"
  int32_t device_type;              // novaphy_device_type
  const char* toolkit;              // in messages: "CUDA"
  const char* driver_variable;      // environment variable that names the driver library
  const char* (*driver_file)();     // its value, or null
  const char* driver_libraries[4];  // tried in order; null ends the list
  int oldest_driver;                // 12000: 12.0
  bool runtime_compiler;            // NOVA_ENABLE_NVRTC
};
const VendorInfo& vendor();

}  // namespace novaphy::gpu
