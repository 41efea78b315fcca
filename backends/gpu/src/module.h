// Modules: a Program, a builtin or a source module as code on the device.
#pragma once

#include <memory>
#include <string>

#include "compiler.h"
#include "device.h"
#include "device_source.h"
#include "novaphy/program/ir.h"

struct novaphy_kernel {
  novaphy_device* device = nullptr;
  // A Program runs `function` or the interpreter in one launch. Other kernels call `run`.
  novaphy::gpu::Function function = nullptr;
  novaphy_status (*run)(novaphy_stream* stream, const novaphy_kernel& kernel, int64_t n,
                        const uint64_t* arguments, novaphy_error* error) = nullptr;
  bool is_block = false;  // blocks of kBlock threads, because threads use their block index
  uint32_t argument_count = 0;
  uint32_t number = 0;  // number that identifies the kernel in the record of a failing read
  uint64_t hash = 0;
  std::string name;
  nova::ir::Program program;  // the compiled Program, for fused lists
  struct {
    novaphy::gpu::DevicePointer code = 0;
    int32_t values = 0;  // interpreter: words per thread
  } interpreted;
};
struct novaphy_module {
  novaphy_device* device = nullptr;
  novaphy::gpu::Module module = nullptr;  // null for builtins, whose module the device keeps
  // The kernel "main", or the kernels of a SOURCE module.
  std::vector<std::unique_ptr<novaphy_kernel>> kernels;
};

namespace novaphy::gpu {

inline constexpr unsigned kBlock = 128, kSmallBlock = 32;
// Returns the largest block size that still gives every unit of the device a block.
inline unsigned threads_of_block(int64_t rows, int32_t units) {
  unsigned threads = kBlock;
  while (threads > kSmallBlock && rows <= (units - 1) * int64_t{threads}) threads /= 2;
  return threads;
}

// Loads code for the device: code that was compiled in the build, code from the cache on disk, or
// code that is compiled now.
novaphy_status load_code(novaphy_device* device, const std::string& source, const std::string& name,
                         Dialect dialect, Module* module, novaphy_error* error);
novaphy_status make_builtin(novaphy_device* device, std::string_view name, novaphy_kernel& kernel,
                            novaphy_error* error);
novaphy_status launch_function(novaphy_stream* stream, Function function, int64_t blocks,
                               unsigned threads, void** arguments, const char* name,
                               novaphy_error* error);

}  // namespace novaphy::gpu
