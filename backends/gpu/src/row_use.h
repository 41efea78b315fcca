// The rows of a source that a Program reads.
#pragma once

#include "novaphy/program/ir.h"

namespace novaphy::gpu {

enum class Rows : uint8_t { None, Own, First, Slots, Others };
Rows rows_read(const nova::ir::Program& program, size_t source);
// Returns whether a source with this number of rows has all rows that are read for rows below n.
// The caller of list_create guarantees the rows that are items of a CSR loop.
bool is_there(const nova::ir::Program& program, size_t source, uint64_t rows, uint64_t n);

}  // namespace novaphy::gpu
