// Modules: a Program, or a builtin, as code on the device.
#pragma once

#include <memory>
#include <string>

#include "compiler.h"
#include "device.h"
#include "device_source.h"
#include "novaphy/program/ir.h"

struct novaphy_kernel {
  novaphy_device* device = nullptr;
  // Of a Program: one launch of `function`, or of the interpreter. Else: whatever `run` does.
  novaphy::gpu::Function function = nullptr;
  novaphy_status (*run)(novaphy_stream* stream, const novaphy_kernel& kernel, int64_t n,
                        const uint64_t* arguments, novaphy_error* error) = nullptr;
  bool is_block = false;  // its threads know the size of a block
  uint32_t argument_count = 0;
  uint32_t number = 0;  // by which a failing read names the kernel
  uint64_t hash = 0;
  std::string name;
  nova::ir::Program program;  // of a compiled Program: what a fused list is made of
  struct {
    novaphy::gpu::DevicePointer code = 0;
    int32_t values = 0;  // words per thread
  } interpreted;
};
struct novaphy_module {
  novaphy_device* device = nullptr;
  novaphy::gpu::Module module = nullptr;  // null: the builtins', which the device keeps
  // One kernel "main", or those that a SOURCE module names.
  std::vector<std::unique_ptr<novaphy_kernel>> kernels;
};

namespace novaphy::gpu {

inline constexpr unsigned kBlock = 128, kSmallBlock = 32;
// As many threads as leave a block to every unit of a device.
inline unsigned threads_of_block(int64_t rows, int32_t units) {
  unsigned threads = kBlock;
  while (threads > kSmallBlock && rows <= (units - 1) * int64_t{threads}) threads /= 2;
  return threads;
}

// Code for the device from text: built ahead, from the cache on disk, or compiled now.
novaphy_status load_code(novaphy_device* device, const std::string& source, const std::string& name,
                         Dialect dialect, Module* module, novaphy_error* error);
novaphy_status make_builtin(novaphy_device* device, std::string_view name, novaphy_kernel& kernel,
                            novaphy_error* error);
novaphy_status launch_function(novaphy_stream* stream, Function function, int64_t blocks,
                               unsigned threads, void** arguments, const char* name,
                               novaphy_error* error);

}  // namespace novaphy::gpu
