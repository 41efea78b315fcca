// Lowers a Program to a flat list of items on numbered values, the common input of the block form
// and the scalar form. Lowering resolves aliases, finds uniform values (equal in all lanes), groups
// loads of neighboring columns and merges multiply-add pairs. Every value gets a register or a
// scalar.
#pragma once

#include <stdint.h>

#include <vector>

#include "executable.h"
#include "novaphy/program/ir.h"

namespace novaphy::cpu {

// Values are the instructions of the Program, followed by values that exist only at run time: the
// row number, accumulators and the state of a CSR loop.
using ValueId = int32_t;
constexpr ValueId kNoValue = -1;

struct LoadGroup {
  int32_t source = 0, column = 0;
  ValueId row = kNoValue;  // Lowering::index_value: the lane's own row
  std::vector<ValueId> targets;
};

struct Item {
  enum class Kind { Op, Load, Skip, LoopBegin, LoopEnd } kind;
  CpuOp op = kArithmeticOps;
  ValueId d = kNoValue, a = kNoValue, b = kNoValue, c = kNoValue;
  int32_t group = -1;    // for Load
  int32_t loop = -1;     // LoopBegin, LoopEnd: this loop; others: the enclosing loop, or -1
  int32_t region = -1;   // item number of the innermost enclosing skip, or -1
  bool polarity = true;  // Skip: the region runs for lanes with a == polarity
  int32_t target = -1;   // Skip: first item after the region
  bool uniform = false;  // one result for all lanes
};

struct LoopValues {
  std::vector<ValueId> accumulators, inits, terms;
  ValueId reduce = kNoValue, slot = kNoValue;  // kNoValue: unused
  ValueId start = kNoValue, length = kNoValue, active = kNoValue;
  int32_t begin = 0, end = 0;  // items [begin, end)
};

struct Lowered {
  std::vector<Item> items;
  std::vector<LoadGroup> groups;
  std::vector<LoopValues> loops;
  std::vector<std::vector<ValueId>> outputs;
  ValueId index_value = kNoValue;
  bool index_used = false;          // whether the row number is also used as a value, not only as
                                    // the row of a load
  std::vector<Operand> place;       // register or scalar of each value
  std::vector<uint32_t> constants;  // values of the scalars [0, n)
  std::vector<int32_t> parameters;  // parameters in the scalars that follow
  int32_t register_count = 0, scalar_count = 0;
  std::vector<int32_t> prologue;  // block form: items that run once per launch
};

// Lowers a Program. In the scalar form every value is a scalar.
Lowered lower(const nova::ir::Program& program, const std::vector<nova::ir::Step>& steps,
              bool scalar_form);

// Assigns a register or a scalar to every value of `lowered`.
void place_values(Lowered& lowered, bool scalar_form);

}  // namespace novaphy::cpu
