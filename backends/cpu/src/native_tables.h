// Kernels that were compiled ahead, found by the hash of their Program. The objects that core links
// have none; the plugin brings its tables.
#pragma once

#include <span>

#include "native.h"
#include "novaphy/program/ir.h"

namespace novaphy::cpu {

struct NativeLevel {
  const char* name;  // of the instruction set; "scalar": one row at a time, for every processor
  std::span<const novaphy_native_table* const> parts;
};

// What runs a Program natively; all null: nothing does.
struct NativeCode {
  novaphy_native_fn rows = nullptr;    // groups of `lanes` rows
  novaphy_native_fn scalar = nullptr;  // single rows
  int32_t lanes = 1;
  // The same for scans of launches, both or none.
  const novaphy_native_scan* scan_rows = nullptr;
  const novaphy_native_scan* scan_scalar = nullptr;
};

// Called by the plugin, before any device is opened.
void set_native_levels(std::span<const NativeLevel> levels);
// Both forms, or none.
NativeCode find_native(const nova::ir::Program& program, const char* isa);

}  // namespace novaphy::cpu
