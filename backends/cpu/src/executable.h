// A Program on the CPU: two instruction lists over plain numbers. The block form runs each
// instruction over a block of lanes (rows); the scalar form runs one row at a time and is for
// launches of very few rows.
//
// Translation units that are compiled for one instruction set include this header. The header must
// not bring in any inline function of a library: the linker could keep the copy that only a newer
// processor can run.
#pragma once

#include <stdint.h>

#include "native.h"
#include "ops.h"

namespace novaphy::cpu {

constexpr int32_t kLanes = 256;     // rows per block
constexpr int32_t kLaneGroup = 16;  // a block's lanes are rounded up to a multiple of this
constexpr int32_t kMaxLoadColumns = 4;

// The name of every arithmetic op; ops.h gives the expressions. MUL_ADD, MUL_SUB and SUB_MUL round
// twice, exactly as the two instructions that they stand for.
enum CpuOp : uint16_t {
#define NOVAPHY_CPU_NAME1(name, r, a, expr) name,
#define NOVAPHY_CPU_NAME2(name, r, a, b, expr) name,
#define NOVAPHY_CPU_NAME3(name, r, a, b, c, expr) name,
  NOVAPHY_CPU_OPS(NOVAPHY_CPU_NAME1, NOVAPHY_CPU_NAME2, NOVAPHY_CPU_NAME3) kArithmeticOps,
  // scalar form only
  kSkipUnless = kArithmeticOps,  // a = condition, jump when it is false
  kSkipIf,
  kLoopBegin,  // a = loop
  kLoopEnd,
  kLoadRow1,  // consecutive columns of row i: a = source, c = column, d, e, f, g = targets
  kLoadRow2,
  kLoadRow3,
  kLoadRow4,
  kLoadAt1,  // the same of row b
  kLoadAt2,
  kLoadAt3,
  kLoadAt4,
  kStore1,  // a = output, c = column, d, e, f, g = values
  kStore2,
  kStore3,
  kStore4,
  kEnd,
  kScalarOps
};

struct ErrorSink : novaphy_error_sink {
  ErrorSink() : novaphy_error_sink{INT64_MAX, 0, 0, 0} {}
};

// A value at run time: a register (one word per lane) or a scalar (one word for all lanes).
struct Operand {
  int32_t slot;
  int32_t uniform;
};

struct SumSlots {
  Operand acc, init, term;
};

struct LoopCode {
  int32_t csr;
  int32_t word;           // launch argument: the extent, or the CSR offsets (items follow)
  int32_t reduce;         // scalar that receives the loop counter, -1: nobody reads it
  int32_t slot;           // receives the item, -1: nobody reads it
  int32_t start, length;  // block form, CSR: registers
  int32_t active;         // block form, CSR: mask register
  int32_t sums_begin, sums_end;
  int32_t body, after;  // scalar form: instruction numbers
};

struct LoadCode {
  int32_t source, width, column, count;  // consecutive columns
  int32_t row;  // register or scalar; not used when the row is the lane's own
  int32_t target[kMaxLoadColumns];
  int32_t guards_begin, guards_end;  // a lane needs the value only when all of these hold
};

struct GuardCode {
  Operand condition;
  int32_t polarity;
};

struct StoreCode {
  int32_t word, width, values_begin;  // operands, one per column
};

struct BlockContext;
struct BlockInstr;
// Runs one instruction over the lanes of a block and returns the next one, null at the end.
using BlockFn = const BlockInstr* (*)(BlockContext&, const BlockInstr&);
struct BlockInstr {
  BlockFn run;
  int32_t d, a, b, c;
};

struct BlockTables {
  const LoadCode* loads;
  const StoreCode* stores;
  const Operand* store_values;
  const LoopCode* loops;
  const SumSlots* sums;
  const GuardCode* guards;
};

struct BlockContext {
  uint32_t* registers;  // kLanes words each
  uint32_t* scalars;
  int32_t lanes;  // rounded up; lanes past `count` compute rubbish that nobody reads
  int32_t count;
  int64_t base;  // row of lane 0
  const uint64_t* arguments;
  BlockTables tables;
  ErrorSink* sink;
  int32_t counter, extent;  // of the loop that runs
};

struct ScalarInstr {
  uint16_t op, d, a, b, c, e, f, g;
};

struct ScalarCode {
  const ScalarInstr* code;
  const LoopCode* loops;
  const SumSlots* sums;
  const int32_t* source_widths;
  const int32_t* output_widths;
  int32_t first_output;  // launch argument word of output 0
  int32_t index;         // the scalar that holds the row number
};

// Rows of three floats, each its `init` (null: +0) and then the rows of its items in their order,
// of one array or of two over the same items: without offsets a row has `stride` items, without
// items they are in order.
struct ThreeSum {
  const float *source, *init;
  float* out;  // null: there is no second sum
};
struct ThreeSums {
  ThreeSum sum[2];
  const int32_t *offsets, *items;
  int64_t stride, longest;
};

// The functions of one instruction set. `ops` is indexed by op and by the set of operands that are
// scalars (bit k: operand k); with all operands scalar the result is a scalar.
struct IsaTable {
  const char* name;
  int32_t lanes;        // of a vector of the processor
  int64_t scalar_rows;  // up to so many rows the scalar form is faster (measured)
  BlockFn ops[kArithmeticOps][8];
  BlockFn index, store, end, loop_begin, loop_end;
  BlockFn load_row, load_at, load_scalar;
  BlockFn skip[2];  // by: the condition is a scalar
  void (*run_scalar)(const ScalarCode& code, const uint64_t* arguments, int64_t begin, int64_t end,
                     uint32_t* scalars, ErrorSink* sink);
  // Returns the first row that it left: one of more items than the longest.
  int64_t (*sum_threes)(const ThreeSums& sums, int64_t row, int64_t last);
};

const IsaTable* isa_baseline();
#if defined(__x86_64__)
const IsaTable* isa_avx2();
const IsaTable* isa_avx512();
#endif

}  // namespace novaphy::cpu
