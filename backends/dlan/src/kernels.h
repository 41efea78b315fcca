// Device code as host stubs: compiled into a shared library, where a kernel is the address of a
// function by which the run-time library launches it.
#pragma once

#include <cstdint>
#include <string>

#include "compiler.h"
#include "driver.h"

namespace novaphy::gpu {

// What a library of kernels holds; written by stub_table(), as text.
struct Stub {
  const char* name;  // null ends the list
  const void* function;
};
struct StubModule {
  uint64_t key[2];    // ahead_key
  const Stub* stubs;  // null ends the list of modules
};

// The library novaphy_dlan_kernels.so beside the plugin, or NOVAPHY_DLAN_KERNELS. Why it cannot be
// used, or nothing. Its modules are what ahead_data() gives.
const std::string& kernels_problem();
// Fills `count` rows, `pitch` bytes apart, with the first `bytes` (1, 2 or 4) of the pattern.
const void* fill_stub();

// Entries of the driver's table. Code is what ahead_data() has, or what kDlanCompiler made.
Result load_stubs(Module* module, const void* code);
Result unload_stubs(Module module);
Result find_stub(Function* function, Module module, const char* name);

// The lines behind the text of a module that list its kernels, as `static const ... stubs[]`.
std::string stub_table(const std::string& source);
// NOVAPHY_DLAN_COMPILER, or none.
extern const CompilerHook kDlanCompiler;

}  // namespace novaphy::gpu
