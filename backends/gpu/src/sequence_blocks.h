// Which rows of a phase each block of a cluster computes. Where the sums of a phase add items that
// the phase before makes (forces that elements put on their corners), a block computes all rows
// that its own sums need, some of them computed by other blocks too. Items then stay in the memory
// of the block, and only what sums leave goes from block to block: one exchange for two phases. The
// results are the same, because every row is the same wherever it is computed.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <span>
#include <vector>

#include "novaphy/abi/backend.h"

namespace novaphy::gpu {

struct BlockPlan {
  static constexpr uint32_t kOwns = 1u << 31;  // stores what others may read
  static constexpr uint32_t kOn = 1u << 30;    // has a row, and does not only go along with others
  // Where the items of sums lie in the memory of a block: rows of four words, `corners` of them for
  // each thread.
  struct Output {
    uint32_t base = 0;
    int32_t width = 0;  // words of an item
  };
  struct Sum {
    uint32_t base = 0;
    uint32_t items = 0;  // index into `items`
  };
  struct Operation {
    std::map<size_t, Output> outputs;
    std::optional<Sum> sum;
  };
  struct Chain {
    uint32_t first_warp = 0, warps = 0;  // of each block
    bool stores = true;                  // leaves more than items
    bool keeps = false;                  // its items are the last ones in their memory
  };
  struct Phase {
    uint32_t layout = 0;
    bool makes_items = false, sums_items = false;  // makes them for the next phase; adds them
    std::vector<Chain> chains;
  };
  std::vector<Phase> phases;
  std::vector<Operation> operations;           // one for each of the sequence
  std::vector<std::vector<uint32_t>> layouts;  // block after block, a word for each thread
  std::vector<std::vector<int32_t>> items;     // instead of a CSR table's
  uint32_t maker_warps = 0;                    // of a block, its first ones; the others add
  uint32_t threads = 0, corners = 0, item_rows = 0;
};

// Reads from the device's memory.
using ReadWords = std::function<std::vector<int32_t>(uint64_t where, size_t count)>;
// None: there are no such sums, or a row has to be known elsewhere, or there are too many of them.
std::optional<BlockPlan> plan_blocks(std::span<const novaphy_sequence_op> ops, uint32_t blocks,
                                     uint32_t most_warps, const ReadWords& read);

}  // namespace novaphy::gpu
