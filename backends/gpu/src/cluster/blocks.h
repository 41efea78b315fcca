// Assigns the rows of each phase to the blocks of a cluster. The sums of a phase may add items that
// the previous phase makes, such as forces of elements on their corners. A block then computes all
// rows that its own sums need, even if other blocks compute the same rows.
//
// Items stay in the memory of their block, and blocks exchange only the results of the sums: one
// exchange for two phases. The results are the same, because a row does not depend on the block
// that computes it.
//
// Blocks exchange the rows of a halo: rows of sums that elements of other blocks read. If these
// rows are known, a block sends them directly to the memory of those blocks, and does not wait for
// global memory.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <span>
#include <vector>

#include "novaphy/abi/backend.h"

namespace novaphy::gpu {

// Threads of a warp. Only vendors with this size support persistent kernels.
inline constexpr uint32_t kWarp = 32;

struct BlockPlan {
  static constexpr uint32_t kOwns = 1u << 31;  // stores a result that others may read
  static constexpr uint32_t kOn = 1u << 30;    // has a row of its own, instead of repeating another
                                               // row
  // The memory of a block holds the items of sums in rows of four words, `corners` rows for each
  // thread.
  struct Output {
    uint32_t base = 0;
    int32_t width = 0;  // words of an item
  };
  struct Sum {
    uint32_t base = 0;
    uint32_t items = 0;  // index into `items`
    int32_t longest = 0;
  };
  struct Operation {
    std::map<size_t, Output> outputs;
    std::optional<Sum> sum;
    // The halo arrays into which an output is sent, and from which a source is read.
    std::map<size_t, uint32_t> sends, receives;
    // Arguments whose rows the same thread has written.
    std::set<int32_t> mine;
  };
  struct Chain {
    uint32_t first_warp = 0, warps = 0;  // in each block
    bool stores = true;                  // stores more than items
    bool keeps = false;                  // its items are the last ones in their memory
  };
  // Rows that are read from global memory.
  struct Fill {
    uint64_t from = 0;
    uint32_t base = 0, rows = 0;
    int32_t width = 0;
    auto operator<=>(const Fill&) const = default;
  };
  struct Phase {
    uint32_t layout = 0;
    bool makes_items = false, sums_items = false;  // makes items for the next phase; sums items of
                                                   // the previous phase
    std::vector<Chain> chains;
    bool sends = false;       // sends rows of the halo
    bool fences = true;       // others read its results from global memory
    bool joined = false;      // runs together with the next phase, which sums its items
    uint32_t turns = 0;       // number of earlier phases that send
    std::vector<Fill> fills;  // done before the phase begins
  };
  // Arrays of rows of four words, each followed by a row of zeros. Even and odd turns have separate
  // arrays: elements read the rows of one turn while other blocks send those of the next.
  struct Halo {
    static constexpr uint32_t kSends = 1u << 31;
    static constexpr uint32_t kBlockShift = 16, kLaneShift = 24;
    uint32_t rows = 0;    // in all arrays
    uint32_t rounds = 0;  // rounds in which a warp sends its rows
    uint32_t turns = 0;   // phases that send
    // For each block and each round, a word for each summing thread: the row, the receiving block,
    // and the lane with the row.
    std::vector<uint32_t> sends;
    std::vector<uint32_t> bytes;  // bytes that each block receives per turn
  };
  std::vector<Phase> phases;
  std::vector<Operation> operations;           // one for each operation of the persistent kernel
  std::vector<std::vector<uint32_t>> layouts;  // for each block, a word per thread
  std::vector<std::vector<int32_t>> items;     // replace the items of a CSR table
  uint32_t maker_warps = 0;                    // the first warps of a block; the other warps sum
  uint32_t threads = 0, corners = 0, item_rows = 0;
  Halo halo;
};

// Reads from the device's memory.
using ReadWords = std::function<std::vector<int32_t>(uint64_t where, size_t count)>;
// Returns no plan if no operation is such a sum, if there are too many rows, or if other operations
// need the items.
std::optional<BlockPlan> plan_blocks(std::span<const novaphy_persistent_op> ops, uint32_t blocks,
                                     uint32_t most_warps, const ReadWords& read);
// Adds a halo to a plan. Returns false and keeps the plan if the readers of the rows are not known.
bool plan_halo(std::span<const novaphy_persistent_op> ops, uint32_t blocks, const ReadWords& read,
               BlockPlan& plan);

}  // namespace novaphy::gpu
