// The Programs that are compiled ahead of time.
#pragma once

#include <string>
#include <vector>

#include "novaphy/program/ir.h"

namespace generator {

// Returns every kernel that the engine defines, and its declared adjoints.
std::vector<nova::ir::Program> engine_programs();
// Reads a file of serialized Programs that a conformance test collects. Returns each Program once.
std::vector<nova::ir::Program> read_programs(const std::string& path);

}  // namespace generator
