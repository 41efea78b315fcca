// The differences between vendors whose devices run CUDA-like code; defined by the plugin.
#pragma once

#include "compiler.h"
#include "driver.h"

namespace novaphy::gpu {

struct VendorInfo {
  const char* name;              // of the backend and its devices: "cuda"
  int32_t device_type;           // novaphy_device_type
  const char* toolkit;           // for messages: "CUDA"
  const char* architecture;      // prefix of an architecture's number: "sm_"
  const char* (*device_text)();  // vendors/<name>.cuh, before all device code
  // The library with the driver functions (driver.h).
  const char* driver_variable;           // environment variable with the library's file
  const char* (*driver_file)();          // value of the variable, or null
  const char* driver_libraries[4];       // tried in order; null ends the list
  bool (*load)(Driver&, void* library);  // load_driver, or a function that fits other functions to
                                         // the table
  int oldest_driver;                     // 12000: 12.0
  const CompilerHook* compiler;          // its options also affect code built ahead of time
  const char* no_compiler;               // null: found at run time; else why there is none
  bool graphs;  // captures become graphs; else they replay launches
  // Threads per warp that persistent kernels assume. 0: no persistent kernels, and no other kernels
  // whose blocks wait for each other.
  unsigned warp;
};
const VendorInfo& vendor();
inline std::string arch_name(int arch) { return vendor().architecture + std::to_string(arch); }

}  // namespace novaphy::gpu
