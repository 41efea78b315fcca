// Device code as host stubs: a vendor's compiler puts kernels into a shared library, where a kernel
// is the address of a host function (its stub). The run-time library launches the kernel by this
// address.
#pragma once

#include <cstdint>
#include <string>

#include "compiler.h"
#include "driver.h"

namespace novaphy::gpu {

// An entry of a library of kernels: a kernel's name and stub. stub_table() writes the entries as
// text.
struct Stub {
  const char* name;  // null ends the list
  const void* function;
};
struct StubModule {
  uint64_t key[2];    // ahead_key
  const Stub* stubs;  // null ends the list of modules
};

// Opens the library novaphy_dlan_kernels.so beside the plugin, or the file NOVAPHY_DLAN_KERNELS.
// Returns the reason why the library cannot be used, or an empty text. ahead_data() returns its
// modules.
const std::string& kernels_problem();
// Returns the stub of a kernel that fills `count` rows, `pitch` bytes apart, with the first `bytes`
// (1, 2 or 4) of a pattern.
const void* fill_stub();

// Functions for the driver's table. The code comes from ahead_data() or from kDlanCompiler.
Result load_stubs(Module* module, const void* code);
Result unload_stubs(Module module);
Result find_stub(Function* function, Module module, const char* name);

// Returns the lines that list the kernels of a module, as `static const ... stubs[]`. These lines
// follow the text of the module.
std::string stub_table(const std::string& source);
// The compiler named by NOVAPHY_DLAN_COMPILER, or none.
extern const CompilerHook kDlanCompiler;

}  // namespace novaphy::gpu
