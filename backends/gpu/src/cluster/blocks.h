// Assigns the rows of each phase of a persistent kernel to the blocks of a cluster. An item is a
// row of an array that a CSR sum adds, such as the force of an element on one of its corners. If
// the previous phase computes the items of a phase's sums, a block computes all items that its own
// sums need, even if other blocks compute the same items. The operations that compute items are
// called makers.
//
// Items stay in the shared memory of their block, and blocks exchange only the results of the sums:
// one exchange for two phases. The results are the same, because a row does not depend on the block
// that computes it.
//
// The halo are the rows of sums that makers of other blocks read. If these rows are known in
// advance, a block sends them directly to the shared memory of those blocks, without the delay of
// global memory. One exchange of the halo is called a turn.
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
  static constexpr uint32_t kOwns = 1u << 31;  // this thread stores the result of the row
  static constexpr uint32_t kOn = 1u << 30;    // has a row of its own, instead of repeating another
                                               // row
  // The shared memory of a block holds the items of sums in rows of four words, `corners` rows for
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
    // The halo array to which an output is sent, or from which a source is read.
    std::map<size_t, uint32_t> sends, receives;
    // Arguments whose rows were written by the thread that reads them.
    std::set<int32_t> mine;
  };
  struct Chain {
    uint32_t first_warp = 0, warps = 0;  // warps in each block
    bool stores = true;                  // whether it stores more than items
    bool keeps = false;                  // whether its items are final and must be stored
  };
  // Rows of a halo array that are loaded from global memory.
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
    bool fences = true;       // other blocks read its results from global memory
    bool joined = false;      // runs together with the next phase, which sums its items
    uint32_t turns = 0;       // number of turns before this phase
    std::vector<Fill> fills;  // loads before the phase begins
  };
  // Arrays of rows of four words, each followed by a row of zeros. Even and odd turns have separate
  // arrays: elements read the rows of one turn while other blocks send those of the next turn.
  struct Halo {
    static constexpr uint32_t kSends = 1u << 31;
    static constexpr uint32_t kBlockShift = 16, kLaneShift = 24;
    uint32_t rows = 0;    // rows in all arrays
    uint32_t rounds = 0;  // rounds in which a warp sends its rows
    uint32_t turns = 0;   // number of phases that send
    // For each block and round, one word for each thread of the warps that sum: the row to send,
    // the receiving block, and the lane that has the row.
    std::vector<uint32_t> sends;
    std::vector<uint32_t> bytes;  // bytes that each block receives per turn
  };
  std::vector<Phase> phases;
  std::vector<Operation> operations;           // one for each operation of the persistent kernel
  std::vector<std::vector<uint32_t>> layouts;  // for each block, a word per thread: its row, kOwns
                                               // and kOn
  std::vector<std::vector<int32_t>> items;     // items of a CSR table as positions in the shared
                                               // memory
  uint32_t maker_warps = 0;                    // the first warps of a block make items; the others
                                               // sum
  uint32_t threads = 0, corners = 0, item_rows = 0;
  Halo halo;
};

// Reads 32-bit words from the memory of the device.
using ReadWords = std::function<std::vector<int32_t>(uint64_t where, size_t count)>;
// Returns a plan, or none if no operation sums items of the previous phase, if a block would have
// too many rows, or if other operations access the items.
std::optional<BlockPlan> plan_blocks(std::span<const novaphy_persistent_op> ops, uint32_t blocks,
                                     uint32_t most_warps, const ReadWords& read);
// Adds a halo to a plan. Returns false and leaves the plan unchanged if the readers of the rows are
// not known.
bool plan_halo(std::span<const novaphy_persistent_op> ops, uint32_t blocks, const ReadWords& read,
               BlockPlan& plan);

}  // namespace novaphy::gpu
