// The text of device code: the prelude, and what the emitter writes for a Program.
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
// What comes before all device code: the vendor's file, the generic one and the prelude.
std::string prelude_text();
// Equal Programs have equal text, whatever their names.
nova::ir::Program without_names(nova::ir::Program program);
// One kernel: novaphy_main(argument words, n, sink), a thread per row.
std::string kernel_source(const nova::ir::Program& program);
std::string builtins_source();
std::string interpreter_source();
// A SOURCE module: what <novaphy/abi/backend.h> says is known to it, then its own text.
std::string module_source(const std::string& text);

}  // namespace novaphy::gpu
