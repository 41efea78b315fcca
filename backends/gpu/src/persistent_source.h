// A persistent kernel as text and table; persistent.cuh says how it runs.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "module.h"
#include "novaphy/program/cut.h"

namespace novaphy::gpu {

struct BlockPlan;
constexpr int32_t kBatch = 12;  // CSR items at once, where a barrier waits for the longest row

// The structure of a chain. Chains of equal structure share their code: only arguments differ.
struct ChainForm {
  struct Operation {
    enum Kind : int32_t { Copy, Fill, RowSum, Program } kind = Program;
    int32_t each = 1;  // rows for each of the chain
    // RowSum: the builtin, or a Program that does the same (see added_rows in ir.h).
    struct Sum {
      int32_t width = 1;
      bool offsets = false, init = false;  // which of its arguments are there
      bool chunks = false;                 // long rows are summed by the builtin's rule
      int32_t items = -1;  // where they lie in the memory of the block; -1: in memory
      int32_t batch = 0;   // no row has more items, which come at once; 0: kBatch of them do
      bool joins = false;  // over the same items as the operation before, and run with it
      // Which argument words they are; items come after offsets.
      int32_t source_word = 0, offsets_word = 1, init_word = 3, out_word = 4;
      auto operator<=>(const Sum&) const = default;
    } sum;
    // Per loop, which of the chain's CSR tables it goes over (-1: the chain does not load it).
    std::vector<int32_t> tables;
    int32_t program = 0;  // index into PersistentTable::programs
    struct Source {
      // There: in memory, with all rows that are read. Own: and only the own one is. First: only
      // row 0 is, and nothing in the persistent kernel writes it.
      enum From : int32_t { Memory, There, Own, First, Registers } from = Memory;
      int32_t op = 0, output = 0;  // Registers: what this operation of the chain left
      bool aligned = false;        // Own: its words lie at a multiple of 16 bytes
      bool fixed =
          false;  // Own, First: worth keeping, as nothing in the persistent kernel writes them
      // Nothing in the phase before writes it, wherever the form occurs, nor does the chain: so it
      // may be read before that phase is over.
      bool early = false;
      bool fixed_rows = false;  // early, and nothing in the persistent kernel writes it
      // Where its rows lie in the memory of the block, and how many; -1: in memory.
      int32_t halo = -1, halo_rows = 0;
      auto operator<=>(const Source&) const = default;
    };
    std::vector<Source> sources;
    struct Output {
      // Now: stored at once. Later: when the chain is done. Never: a later operation writes there
      // too.
      enum Store : int32_t { Now, Later, Never } store = Now;
      int32_t width = 1;
      bool aligned = false;                // as of a source
      int32_t items = -1, item_width = 0;  // its items go to the memory of the block, too
      int32_t halo = -1;                   // and its row to that of other blocks
      auto operator<=>(const Output&) const = default;
    };
    std::vector<Output> outputs;
    int32_t first_word = 0;  // of its arguments in the chain's
    // Where the chain's words name the memory of what its early half leaves, which a launch of its
    // own computes for all phases at once; -1: it is computed in its phase.
    int32_t early_word = -1;
    auto operator<=>(const Operation&) const = default;
  };
  std::vector<Operation> operations;
  std::vector<int32_t> tables;  // the chain's word of each CSR table's offsets; items come next
  bool sums_items = false;      // the phase adds items that the block has made in the one before
  auto operator<=>(const ChainForm&) const = default;
};

struct PersistentTable {
  std::vector<const nova::ir::Program*> programs;  // each once
  std::vector<ChainForm> forms;                    // each once
  std::vector<uint64_t> words;                     // the records, then a word for the barrier
  uint64_t first_words = 0, most_words = 0;        // of the first and of the largest record
  uint64_t counters = 0;                           // where the barrier's word lies
  uint32_t kept_words = 0;                         // what threads keep between phases, each
  uint64_t tasks = 0;  // where those of the warps lie; 0: there are none
  uint64_t rows = 0;   // where the rows of threads lie, by layout and block
  uint32_t layouts = 0, corners = 0, item_rows = 0;  // see BlockPlan
  uint32_t halo_rows = 0, halo_rounds = 0, halo_turns = 0, maker_warps = 0;
  std::vector<uint64_t> relative;  // words that count bytes from the first one
  // Early halves that are computed before: see run_job in persistent.cuh.
  uint64_t jobs = 0, job_count = 0, job_slots = 0;  // where they lie, how many, the most threads
  uint64_t early_bytes = 0;                         // what they leave
  std::vector<uint64_t> early;                      // words that count bytes from its first one
  bool fits = true;
  // Of a source: words of a row, and which argument word has its address.
  int32_t source_width(const ChainForm::Operation& op, size_t source) const;
  int64_t source_word(const ChainForm::Operation& op, size_t source) const;
  // Words that a chain loads of a source when it begins; 0: it does not.
  int32_t loaded_words(const ChainForm::Operation& op, size_t source) const;
  const nova::ir::Program& program(const ChainForm::Operation& op) const {
    return *programs[static_cast<size_t>(op.program)];
  }
};
// The two halves of a Program in a chain; without outputs of `early`: it stays whole.
nova::ir::Cut halves_of(const PersistentTable& table, const ChainForm::Operation& op);
// Words of a row of what an early half leaves, which is loaded by fours.
inline uint64_t crossing_words(const nova::ir::Output& output) {
  return (output.values.size() + 3) / 4 * 4;
}

// What a table may count on where no thread has more than one row of a phase.
struct PersistentRoom {
  uint32_t warps = 0;       // for a phase
  uint32_t kept_words = 0;  // how many a thread may keep
  uint32_t blocks = 0;      // 0: warps have no tasks
  // Phases take turns among so many groups of warps: while those of one work, those of the next do
  // what they can before it is over.
  uint32_t groups = 1;
  const BlockPlan* plan = nullptr;
  uint64_t early_bytes = 0;  // of memory, for what is computed early
};
PersistentTable persistent_table(std::span<const novaphy_persistent_op> ops,
                                 const PersistentRoom& room = {});
// Warps of the phase that has most, with a row for each thread.
uint32_t most_warps(std::span<const novaphy_persistent_op> ops);

constexpr unsigned kMostInCluster = 8;  // blocks, on every device that has clusters
struct PersistentShape {
  enum class Form : uint8_t { Block, Cluster, Grid } form = Form::Block;
  unsigned blocks = 1, threads = 128;
  unsigned groups = 1;  // of warps, among which phases take turns
  bool is_large() const { return form == Form::Cluster && blocks > kMostInCluster; }
};
std::string persistent_source(const PersistentTable& table, const PersistentShape& shape);
// The shared memory that a block of it takes: what the text says, and what a launch adds.
uint64_t shared_bytes(const PersistentTable& table, const PersistentShape& shape);
uint64_t launch_bytes(const PersistentTable& table, const PersistentShape& shape);

}  // namespace novaphy::gpu
