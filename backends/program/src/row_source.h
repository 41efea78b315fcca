// Which row the sums of a loop are about.
#pragma once

#include "novaphy/program/ir.h"

namespace nova::ir {

// The source of which the initial values (or the terms) of a loop's sums are the columns of one
// row, all of them and in their order; `row` makes the row's number. -1: none.
inline int32_t row_source(const Program& p, const Loop& loop, Value Sum::*value, Op row) {
  if (loop.sums.empty()) return -1;
  const auto instr = [&](Value v) -> const Instr& { return p.instrs[static_cast<size_t>(v)]; };
  const int32_t source = instr(loop.sums[0].*value).a;
  int32_t column = 0;
  for (const Sum& sum : loop.sums) {
    const Instr& in = instr(sum.*value);
    if (in.op != Op::LOAD_F || in.a != source || in.c != column++ || instr(in.b).op != row)
      return -1;
  }
  return p.sources[static_cast<size_t>(source)].width == column ? source : -1;
}

}  // namespace nova::ir
