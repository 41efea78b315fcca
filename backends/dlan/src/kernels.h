// Device code as host stubs. Kernels are compiled into a shared library, where a kernel is the
// address of a function. The run-time library launches the kernel by that address.
#pragma once

#include <cstdint>
#include <string>

#include "compiler.h"
#include "driver.h"

namespace novaphy::gpu {

// The contents of a library of kernels. stub_table() writes them as text.
struct Stub {
  const char* name;  // null ends the list
  const void* function;
};
struct StubModule {
  uint64_t key[2];    // ahead_key
  const Stub* stubs;  // null ends the list of modules
};

// Opens the library novaphy_dlan_kernels.so beside the plugin, or NOVAPHY_DLAN_KERNELS. Returns why
// the library cannot be used, or an empty text. ahead_data() returns its modules.
const std::string& kernels_problem();
// Fills `count` rows, `pitch` bytes apart, with the first `bytes` (1, 2 or 4) of the pattern.
const void* fill_stub();

// Entries of the driver's table. The code comes from ahead_data() or from kDlanCompiler.
Result load_stubs(Module* module, const void* code);
Result unload_stubs(Module module);
Result find_stub(Function* function, Module module, const char* name);

// Returns the lines that list the kernels of a module, as `static const ... stubs[]`. These lines
// follow the text of the module.
std::string stub_table(const std::string& source);
// The command NOVAPHY_DLAN_COMPILER, or none.
extern const CompilerHook kDlanCompiler;

}  // namespace novaphy::gpu
