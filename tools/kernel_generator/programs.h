// The Programs that are compiled ahead.
#pragma once

#include <string>
#include <vector>

#include "novaphy/program/ir.h"

namespace generator {

// Every kernel that the engine defines, with the adjoints that it declares.
std::vector<nova::ir::Program> engine_programs();
// Serialized Programs, one after the other (a conformance test collects them); every one once.
std::vector<nova::ir::Program> read_programs(const std::string& path);

}  // namespace generator
