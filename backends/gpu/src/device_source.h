// The source of device code: the prelude, and the source that the emitter writes for a Program.
#pragma once

#include <string>

#include "novaphy/program/ir.h"

namespace novaphy::gpu {

inline constexpr const char* kEntry = "novaphy_main";
inline constexpr const char* kInterpreterEntry = "novaphy_interpreter";

const char* cuda_text();            // vendors/cuda.cuh
const char* dlan_text();            // vendors/dlan.cuh
const char* generic_text();         // vendors/generic.cuh
const char* device_prelude_text();  // device_prelude.cuh
const char* builtins_text();        // builtins.cuh
const char* interpreter_text();     // interpreter.cuh
const char* persistent_text();      // persistent.cuh
// Returns the text before all device code: the vendor's file, the generic file and the prelude.
std::string prelude_text();
// Removes the names, so that equal Programs have equal text.
nova::ir::Program without_names(nova::ir::Program program);
// Returns the text of one kernel: novaphy_main(argument words, n, sink), with a thread per row.
std::string kernel_source(const nova::ir::Program& program);
std::string builtins_source();
std::string interpreter_source();
// Returns a SOURCE module: the declarations promised in <novaphy/abi/backend.h>, and then its own
// text.
std::string module_source(const std::string& text);

}  // namespace novaphy::gpu
