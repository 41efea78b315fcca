// Internal: running many recorded operations block by block of rows, so that a block's data stays
// in the cache from one operation to the next. Possible while every operation touches written
// memory at its own row only.
#pragma once

#include <cstdint>
#include <vector>

#include "novaphy/nova/op_list.h"
#include "novaphy/program/ir.h"

namespace nova::detail {

// How the arguments of a Program depend on the row.
struct RowLayout {
  struct Word {
    uint32_t word;       // argument word that holds a pointer
    uint32_t row_bytes;  // bytes per row
  };
  bool row_local = false;     // the row number is used for nothing but direct reads and writes
  std::vector<Word> inputs;   // advanced by the row
  std::vector<Word> outputs;  // advanced by the row
  std::vector<Word> tables;   // advanced by the row; index data that no kernel writes
  std::vector<Word> shared;   // read at other rows; the word after it is the number of rows
};
RowLayout row_layout(const ir::Program& program);

// A stretch of operations; n > 0: to be run block by block over n rows.
struct Segment {
  uint32_t first = 0, last = 0;
  int64_t n = 0;
};
inline constexpr int64_t kBlockRows = 1024;
inline constexpr uint32_t kMaxFusedWords = 192;  // argument words of a launch that can be fused
// Of at least `min_rows` rows and two operations each.
std::vector<Segment> find_segments(std::span<const OpList::Op> ops, std::span<const uint64_t> words,
                                   int64_t min_rows = 2 * kBlockRows);

// Runs one segment block by block on the threads. Throws like a launch.
void run_fused(const novaphy::DeviceContext& context, std::span<const OpList::Op> ops,
               std::span<const uint64_t> words, const Segment& segment);

}  // namespace nova::detail
