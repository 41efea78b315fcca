// The rows of a phase that each block of a cluster computes. The sums of a phase may add items that
// the phase before makes, such as forces of elements on their corners. A block then computes all
// rows that its own sums need, even if other blocks compute them too. Items then stay in the memory
// of the block, and only what sums leave goes from block to block: one exchange for two phases. The
// results are the same, because every row is the same wherever it is computed.
//
// Blocks exchange the rows of a halo: rows of sums that elements of other blocks read. Where these
// rows are known, a block sends them straight to the memory of those blocks, and nobody waits until
// memory has them.
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

// Threads of a warp; persistent kernels are for vendors that say so.
inline constexpr uint32_t kWarp = 32;

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
    int32_t longest = 0;
  };
  struct Operation {
    std::map<size_t, Output> outputs;
    std::optional<Sum> sum;
    // Where the rows of an output go in other blocks, and where those of a source come.
    std::map<size_t, uint32_t> sends, receives;
    // Arguments whose rows are what the same thread has left there.
    std::set<int32_t> mine;
  };
  struct Chain {
    uint32_t first_warp = 0, warps = 0;  // of each block
    bool stores = true;                  // leaves more than items
    bool keeps = false;                  // its items are the last ones in their memory
  };
  // Rows that come from memory.
  struct Fill {
    uint64_t from = 0;
    uint32_t base = 0, rows = 0;
    int32_t width = 0;
    auto operator<=>(const Fill&) const = default;
  };
  struct Phase {
    uint32_t layout = 0;
    bool makes_items = false, sums_items = false;  // makes them for the next phase; adds them
    std::vector<Chain> chains;
    bool sends = false;       // rows of the halo
    bool fences = true;       // others read what it stores from memory
    bool joined = false;      // runs with the next one, which adds its items, as one phase
    uint32_t turns = 0;       // phases before that send
    std::vector<Fill> fills;  // before it begins
  };
  // Arrays of rows of four words, each with one of zeros behind its last. There are two of each,
  // for turns that are odd or even: elements read what came in one while others send the next.
  struct Halo {
    static constexpr uint32_t kSends = 1u << 31;
    static constexpr uint32_t kBlockShift = 16, kLaneShift = 24;
    uint32_t rows = 0;    // of all arrays
    uint32_t rounds = 0;  // in which a warp sends its rows
    uint32_t turns = 0;   // phases that send
    // Block after block, round after round, a word for each thread that adds: the row, the block to
    // which it goes, and the lane that has it.
    std::vector<uint32_t> sends;
    std::vector<uint32_t> bytes;  // that a block gets each time
  };
  std::vector<Phase> phases;
  std::vector<Operation> operations;           // one for each of the persistent kernel
  std::vector<std::vector<uint32_t>> layouts;  // block after block, a word for each thread
  std::vector<std::vector<int32_t>> items;     // instead of a CSR table's
  uint32_t maker_warps = 0;                    // of a block, its first ones; the others add
  uint32_t threads = 0, corners = 0, item_rows = 0;
  Halo halo;
};

// Reads from the device's memory.
using ReadWords = std::function<std::vector<int32_t>(uint64_t where, size_t count)>;
// None: there are no such sums, or a row has to be known elsewhere, or there are too many of them.
std::optional<BlockPlan> plan_blocks(std::span<const novaphy_persistent_op> ops, uint32_t blocks,
                                     uint32_t most_warps, const ReadWords& read);
// Adds a halo to a plan; false: it is not known who reads what, and the plan stays as it was.
bool plan_halo(std::span<const novaphy_persistent_op> ops, uint32_t blocks, const ReadWords& read,
               BlockPlan& plan);

}  // namespace novaphy::gpu
