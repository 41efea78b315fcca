// Adjoints: from the Program of a kernel to the Programs that pull gradients of its outputs back to
// its sources.
//
// The instruction set is closed under the adjoint. A gather becomes a row-sum over the inverse of
// the index table, a row-sum becomes a gather, and a uniform read becomes a row-sum with one row.
// No atomics, so the order of every sum is fixed. One Program is made per output domain:
//   rows   one lane per output row: gradients of direct sources, and the part of each row for
//          uniform and indexed sources
//   items  one lane per loop item (CSR slot, or (row, r) pair of a fixed loop): gradients of sources
//          that are read inside the loop at the item
// Each Program recomputes the primal values it needs, and runs one reverse sweep.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "novaphy/nova/export.h"
#include "novaphy/program/ir.h"

namespace nova {

// Which gradients are wanted and which are given.
struct AdjointMask {
  std::vector<bool> wrt;         // per source: its gradient is wanted
  std::vector<bool> accumulate;  // per source: add to the gradient that is there (else store)
  std::vector<bool> seeded;      // per output: has a gradient
  // Or -1: the source whose columns name the rows that the output was added to, a part of the
  // output for each column. The gradient given is that of the sums, and read there.
  int32_t table = -1;
  // Or -1: the source of whose gradient nobody reads these columns, as bits. They are stored as 0,
  // or left as they are.
  int32_t narrowed = -1;
  uint32_t unread = 0;
  // Each launch says which gradients are wanted, which are added to, and whether somebody reads the
  // columns `unread`: see AdjointStage::gates. Then `accumulate` is not looked at.
  bool gated = false;
  auto operator<=>(const AdjointMask&) const = default;
};

// Where a source of an adjoint Program comes from, or where an output goes.
struct AdjointBinding {
  enum class Kind : uint8_t {
    PrimalSource,    // index = source of the kernel
    OutputGradient,  // index = output of the kernel
    SourceGradient,  // index = source of the kernel: its gradient, in place when accumulating
    Contribution,    // index = entry of AdjointPlan::row_sums
    LoopGradient,    // gradient of the loop's sums, {n, sums}: made by `rows`, read by `items`
    RowOfItem,       // CSR: the row that an item belongs to (the table the Incidence inverts)
  } kind;
  int32_t index = 0;
};

struct AdjointStage {
  ir::Program program;
  std::vector<AdjointBinding> sources, outputs;
  bool takes_row_count =
      false;  // one more i32 parameter at the end: the number of rows n (fixed loops)
  // Of a gated adjoint: the sources of which a parameter after that has the bits of AdjointGate.
  std::vector<int32_t> gates;
};

// What a launch says of the gradient of a source.
enum AdjointGate : uint32_t {
  kGateWanted = 1,   // else it is stored as 0
  kGateAdd = 2,      // added to what is there, else stored
  kGateColumns = 4,  // with the columns AdjointMask::unread, else these are 0
};

// After the stages: gradient of `source` (+)= row-sum of a contribution.
struct AdjointRowSum {
  // Row: an indexed source that is read at the row (or item) itself; its other reads have sums of
  // their own.
  enum class Kind : uint8_t { Uniform, Table, Reduced, Row } kind;
  int32_t source = 0;
  int32_t table = -1;  // Table: the i32 source whose Incidence gives the rows
  bool per_item =
      false;  // the contribution has one row per loop item (times the table's width), else per row
  int32_t width = 1;
};

struct AdjointPlan {
  std::vector<AdjointStage> rows;   // zero or one
  std::vector<AdjointStage> items;  // zero or one
  std::vector<AdjointRowSum> row_sums;
  std::vector<bool> loads_value;  // per source: the adjoint reads its value
};

// Makes the plan. `program` still carries PARTIAL and DETACH. Throws novaphy::Error when a wanted
// source is read in a way that has no gradient (an integer source, a computed row).
NOVAPHY_NOVA_API AdjointPlan make_adjoint(const ir::Program& program, const AdjointMask& mask);

}  // namespace nova
