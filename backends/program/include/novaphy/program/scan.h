// A scan: successive launches of one Program, where each launch reads the previous launch's results
// at its own row. The steps of a rollout form a scan, and so do their adjoints. A scan can run all
// launches for a few rows with the state in registers, and load unchanging data once.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "novaphy/program/ir.h"

namespace nova::ir {

struct Scan {
  std::vector<int32_t> carried;  // per output: the source through which the next launch reads the
                                 // output
  std::vector<int32_t> varying;  // sources that may have a different array in every launch
};

// Returns whether a scan may write rows of this type and width past the caches. It then keeps a
// copy of the rows in memory that stays in the caches, for the next launch.
inline bool handed_over(Type type, int32_t width) { return type == Type::F32 && width == 3; }

// Returns the bytes per row of the memory where a scan keeps the carried sources of one launch.
int32_t scratch_bytes(const Program& program, std::span<const int32_t> carried);

// Returns the scan that the Program declares with Output::carried and Source::varies. All other
// sources, tables and parameters must be the same in every launch. Returns no scan if an output is
// not carried, if its source is also read at other rows, or if the Program is too small to gain
// from a scan.
std::optional<Scan> find_scan(const Program& program);

}  // namespace nova::ir
