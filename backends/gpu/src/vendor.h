// The differences between vendors whose devices run CUDA-like code; defined by the plugin.
#pragma once

#include "compiler.h"
#include "driver.h"

namespace novaphy::gpu {

struct VendorInfo {
  const char* name;              // of the backend and its devices: "cuda"
  int32_t device_type;           // novaphy_device_type
  const char* toolkit;           // in messages: "CUDA"
  const char* architecture;      // before the number of one: "sm_"
  const char* (*device_text)();  // vendors/<name>.cuh, before all device code
  // The library behind the table of functions (driver.h).
  const char* driver_variable;           // environment variable that names it
  const char* (*driver_file)();          // its value, or null
  const char* driver_libraries[4];       // tried in order; null ends the list
  bool (*load)(Driver&, void* library);  // load_driver, or what fits other functions to the table
  int oldest_driver;                     // 12000: 12.0
  const CompilerHook* compiler;          // its options decide about code that was built ahead, too
  const char* no_compiler;               // null: it is looked for at run time; else why not
  bool graphs;  // captures become graphs; else they are replayed as launches
  // Threads of a warp that persistent kernels rely on; 0: there are no such kernels, nor others
  // whose blocks wait for each other.
  unsigned warp;
};
const VendorInfo& vendor();
inline std::string arch_name(int arch) { return vendor().architecture + std::to_string(arch); }

}  // namespace novaphy::gpu
