// Kernels compiled ahead of time, found by the hash of their Program. The objects that core links
// have none; the plugin has tables.
#pragma once

#include <span>

#include "native.h"
#include "novaphy/program/ir.h"

namespace novaphy::cpu {

struct NativeLevel {
  const char* name;  // name of the instruction set; "scalar": one row at a time, on every processor
  std::span<const novaphy_native_table* const> parts;
};

// The native code of a Program; all null: there is none.
struct NativeCode {
  novaphy_native_fn rows = nullptr;    // groups of `lanes` rows
  novaphy_native_fn scalar = nullptr;  // single rows
  int32_t lanes = 1;
  // Native code of the Program as scans of launches. Either both are set, or neither.
  const novaphy_native_scan* scan_rows = nullptr;
  const novaphy_native_scan* scan_scalar = nullptr;
};

// The plugin calls this before any device is opened.
void set_native_levels(std::span<const NativeLevel> levels);
// Returns both forms, or neither.
NativeCode find_native(const nova::ir::Program& program, const char* isa);

}  // namespace novaphy::cpu
