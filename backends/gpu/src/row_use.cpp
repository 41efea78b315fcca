#include "row_use.h"

namespace novaphy::gpu {

Rows rows_read(const nova::ir::Program& p, size_t s) {
  using nova::ir::Op;
  Rows rows = Rows::None;
  for (const nova::ir::Instr& in : p.instrs) {
    if ((in.op != Op::LOAD_F && in.op != Op::LOAD_I) || in.a != static_cast<int32_t>(s)) continue;
    const nova::ir::Instr& row = p.instrs[static_cast<size_t>(in.b)];
    const Rows here = row.op == Op::INDEX                   ? Rows::Own
                      : row.op == Op::SLOT                  ? Rows::Slots
                      : row.op == Op::CONST_I && row.a == 0 ? Rows::First
                                                            : Rows::Others;
    rows = rows == Rows::None || rows == here ? here : Rows::Others;
  }
  return rows;
}

bool is_there(const nova::ir::Program& p, size_t s, uint64_t rows, uint64_t n) {
  const Rows read = rows_read(p, s);
  return read == Rows::Slots || (read == Rows::Own && rows >= n) ||
         (read == Rows::First && rows >= 1);
}

}  // namespace novaphy::gpu
