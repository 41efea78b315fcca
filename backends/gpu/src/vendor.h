// The differences between vendors whose devices run CUDA-like code. Each plugin defines them.
#pragma once

#include "compiler.h"
#include "driver.h"

namespace novaphy::gpu {

struct VendorInfo {
  const char* name;              // name of the backend and its devices: "cuda"
  int32_t device_type;           // novaphy_device_type
  const char* toolkit;           // for messages: "CUDA"
  const char* architecture;      // prefix of an architecture's number: "sm_"
  const char* (*device_text)();  // vendors/<name>.cuh, before all device code
  // How to find the library with the driver functions (driver.h).
  const char* driver_variable;           // environment variable with the library's file
  const char* (*driver_file)();          // value of the variable, or null
  const char* driver_libraries[4];       // tried in order; null ends the list
  bool (*load)(Driver&, void* library);  // load_driver, or a function that puts other functions
                                         // into the table
  int oldest_driver;                     // 12000: 12.0
  const CompilerHook* compiler;          // its options also affect code that is compiled ahead of
                                         // time
  const char* no_compiler;               // reason why there is no compiler; null: find one at run
                                         // time
  bool graphs;  // captures become graphs; otherwise they replay launches
  // Threads per warp that persistent kernels assume. 0 means that this vendor supports no kernels
  // whose blocks wait for each other, such as persistent kernels.
  unsigned warp;
};
const VendorInfo& vendor();
inline std::string arch_name(int arch) { return vendor().architecture + std::to_string(arch); }

}  // namespace novaphy::gpu
