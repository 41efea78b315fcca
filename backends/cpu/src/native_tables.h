// Kernels compiled ahead of time, found by the hash of their Program. Only the plugin has such
// kernels; the objects that are linked into core have none.
#pragma once

#include <span>

#include "native.h"
#include "novaphy/program/ir.h"

namespace novaphy::cpu {

struct NativeLevel {
  const char* name;  // name of the instruction set; "scalar": one row at a time, on every processor
  std::span<const novaphy_native_table* const> parts;
};

// The native code of a Program. All members are null if none was compiled.
struct NativeCode {
  novaphy_native_fn rows = nullptr;    // groups of `lanes` rows
  novaphy_native_fn scalar = nullptr;  // single rows
  int32_t lanes = 1;
  // Native code of the Program as scans of launches. Both are set, or both are null.
  const novaphy_native_scan* scan_rows = nullptr;
  const novaphy_native_scan* scan_scalar = nullptr;
};

// The plugin calls this function before any device is opened.
void set_native_levels(std::span<const NativeLevel> levels);
// Returns the native code for groups of rows and for single rows, or neither.
NativeCode find_native(const nova::ir::Program& program, const char* isa);

}  // namespace novaphy::cpu
