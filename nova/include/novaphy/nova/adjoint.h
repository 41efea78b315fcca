// Generates adjoints: from the Program of a kernel, the Programs that propagate gradients of the
// outputs back to the sources.
//
// The adjoint of every instruction is expressed in the same instruction set. The adjoint of a
// gather is a row sum over the inverse of the index table. The adjoint of a row sum is a gather,
// and the adjoint of a uniform read is a row sum with one row. No atomics are used, so the order of
// every sum is fixed. An adjoint has up to two Programs:
//   rows   runs once per output row: gradients of sources that are read at this row, and the row's
//          contributions to uniform and indexed sources
//   items  runs once per loop item (CSR slot, or pair of row and r of a fixed loop): gradients of
//          the sources that the loop reads at the item
// Each Program recomputes the primal values that it needs and runs one reverse sweep.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "novaphy/nova/export.h"
#include "novaphy/program/ir.h"

namespace nova {

// Selects the gradients that an adjoint computes, and says which output gradients are given.
struct AdjointMask {
  std::vector<bool> wrt;         // per source: whether its gradient is computed
  std::vector<bool> accumulate;  // per source: adds to the present gradient (else stores)
  std::vector<bool> seeded;      // per output: whether its gradient is given
  // The index table (a source) by which the caller sums the output after the kernel; -1: none. Each
  // column of the table takes an equal part of the output's columns. The given gradient belongs to
  // the sums, so the adjoint gathers its rows by the table.
  int32_t table = -1;
  // The source with gradient columns that no later operation reads; -1: none. The bits of `unread`
  // select the columns. The adjoint stores 0 in these columns or leaves them unchanged.
  int32_t narrowed = -1;
  uint32_t unread = 0;
  // Whether each launch chooses the gradients by the parameters AdjointStage::gates. `accumulate`
  // is then ignored.
  bool gated = false;
  auto operator<=>(const AdjointMask&) const = default;
};

// The data behind a source or an output of an adjoint Program.
struct AdjointBinding {
  enum class Kind : uint8_t {
    PrimalSource,    // index = source of the kernel
    OutputGradient,  // index = output of the kernel
    SourceGradient,  // index = source of the kernel: its gradient, updated in place when
                     // accumulating
    Contribution,    // index = entry of AdjointPlan::row_sums
    LoopGradient,    // gradient of the loop's sums, {n, sums}; `rows` writes it, `items` reads it
    RowOfItem,       // CSR: the row that each item belongs to (the table behind the Incidence)
  } kind;
  int32_t index = 0;
};

struct AdjointStage {
  ir::Program program;
  std::vector<AdjointBinding> sources, outputs;
  bool takes_row_count =
      false;  // whether the last i32 parameter is the number of rows n, as fixed loops need
  // For a gated adjoint: the sources whose gradients the launch chooses. Each of them has a further
  // parameter with bits of AdjointGate.
  std::vector<int32_t> gates;
};

// Bits by which a launch of a gated adjoint selects the gradient of a source.
enum AdjointGate : uint32_t {
  kGateWanted = 1,   // computed; otherwise 0 is stored
  kGateAdd = 2,      // added to the present gradient; otherwise stored
  kGateColumns = 4,  // the columns AdjointMask::unread are computed; otherwise 0
};

// A row sum that runs after the stages. The row sum of a contribution is stored in, or added to,
// the gradient of `source`.
struct AdjointRowSum {
  // How the rows of the sum depend on the contributions. Uniform: all add to row 0. Table: an index
  // table has the row. Reduced: row r of a fixed loop. Row: the row (or item) itself, for a source
  // that is also read at other rows, whose sums are separate entries.
  enum class Kind : uint8_t { Uniform, Table, Reduced, Row } kind;
  int32_t source = 0;
  int32_t table = -1;  // Table: the i32 source whose Incidence gives the rows
  bool per_item =
      false;  // whether there is a contribution per loop item (times the table's width) instead of
              // per row
  int32_t width = 1;
};

struct AdjointPlan {
  std::vector<AdjointStage> rows;   // zero or one stage
  std::vector<AdjointStage> items;  // zero or one stage
  std::vector<AdjointRowSum> row_sums;
  std::vector<bool> loads_value;  // per source: whether the adjoint reads its value
};

// Makes the plan of an adjoint. `program` must still contain PARTIAL and DETACH. Throws
// novaphy::Error if a requested source has no gradient: an integer source, or a source that is read
// at a computed row.
NOVAPHY_NOVA_API AdjointPlan make_adjoint(const ir::Program& program, const AdjointMask& mask);

}  // namespace nova
