// A Program on the CPU, as two instruction lists whose operands are plain integers. The block form
// runs each instruction over a block of lanes (rows). The scalar form runs one row at a time, for
// launches of very few rows.
//
// Translation units for one instruction set include this header. The header must not include any
// inline function of a library: the linker could keep a copy that only a newer processor can run.
#pragma once

#include <stdint.h>

#include "native.h"
#include "ops.h"

namespace novaphy::cpu {

constexpr int32_t kLanes = 256;     // rows per block
constexpr int32_t kLaneGroup = 16;  // the lanes of a block are rounded up to a multiple of this
constexpr int32_t kMaxLoadColumns = 4;

// The names of all arithmetic operations; ops.h has the expressions. MUL_ADD, MUL_SUB and SUB_MUL
// round twice, exactly like the two instructions that they replace.
enum CpuOp : uint16_t {
#define NOVAPHY_CPU_NAME1(name, r, a, expr) name,
#define NOVAPHY_CPU_NAME2(name, r, a, b, expr) name,
#define NOVAPHY_CPU_NAME3(name, r, a, b, c, expr) name,
  NOVAPHY_CPU_OPS(NOVAPHY_CPU_NAME1, NOVAPHY_CPU_NAME2, NOVAPHY_CPU_NAME3) kArithmeticOps,
  // The operations below exist only in the scalar form.
  kSkipUnless = kArithmeticOps,  // a = condition; jumps if the condition is false
  kSkipIf,
  kLoopBegin,  // a = loop
  kLoopEnd,
  kLoadRow1,  // consecutive columns of row i; a = source, c = column, d, e, f, g = targets
  kLoadRow2,
  kLoadRow3,
  kLoadRow4,
  kLoadAt1,  // the same columns of row b
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
  int32_t word;           // launch argument: the extent, or the CSR offsets (followed by the items)
  int32_t reduce;         // scalar for the loop counter; -1: unused
  int32_t slot;           // receives the item; -1: unused
  int32_t start, length;  // block form, CSR: registers
  int32_t active;         // block form, CSR: mask register
  int32_t sums_begin, sums_end;
  int32_t body, after;  // scalar form: instruction numbers
};

struct LoadCode {
  int32_t source, width, column, count;  // number of consecutive columns
  int32_t row;  // register or scalar; unused for the lane's own row
  int32_t target[kMaxLoadColumns];
  int32_t guards_begin, guards_end;  // only lanes for which all these guards hold need the value
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
// Runs one instruction over the lanes of a block. Returns the next instruction, null at the end.
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
  uint32_t* registers;  // kLanes words per register
  uint32_t* scalars;
  int32_t lanes;  // rounded up to a group; results of lanes past `count` are ignored
  int32_t count;
  int64_t base;  // row of lane 0
  const uint64_t* arguments;
  BlockTables tables;
  ErrorSink* sink;
  int32_t counter, extent;  // of the current loop
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

// Sums of rows of three floats. A row starts from its `init` (null: +0) and adds its items in
// order. Two arrays may be summed over the same items. Without offsets a row has `stride` items.
// Without `items` these are consecutive rows.
struct ThreeSum {
  const float *source, *init;
  float* out;  // null: no second sum
};
struct ThreeSums {
  ThreeSum sum[2];
  const int32_t *offsets, *items;
  int64_t stride, longest;
};

// The functions for one instruction set. The first index of `ops` is the operation. The second
// index says which operands are scalars (bit k: operand k). If all operands are scalars, so is the
// result.
struct IsaTable {
  const char* name;
  int32_t lanes;        // lanes of a vector register
  int64_t scalar_rows;  // the scalar form is faster up to this many rows (measured)
  BlockFn ops[kArithmeticOps][8];
  BlockFn index, store, end, loop_begin, loop_end;
  BlockFn load_row, load_at, load_scalar;
  BlockFn skip[2];  // [1]: for a condition that is a scalar
  void (*run_scalar)(const ScalarCode& code, const uint64_t* arguments, int64_t begin, int64_t end,
                     uint32_t* scalars, ErrorSink* sink);
  // Returns the first row that was not summed, because it has more than `longest` items.
  int64_t (*sum_threes)(const ThreeSums& sums, int64_t row, int64_t last);
};

const IsaTable* isa_baseline();
#if defined(__x86_64__)
const IsaTable* isa_avx2();
const IsaTable* isa_avx512();
#endif

}  // namespace novaphy::cpu
