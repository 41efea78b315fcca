// The source and the table of a persistent kernel. persistent.cuh describes how the kernel runs.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "module.h"
#include "novaphy/program/cut.h"

namespace novaphy::gpu {

struct BlockPlan;
constexpr int32_t kBatch = 12;  // CSR items that are loaded together, because a barrier waits for
                                // the longest row

// The structure of a chain. Chains of equal structure share code and differ only in their
// arguments.
struct ChainForm {
  struct Operation {
    enum Kind : int32_t { Copy, Fill, RowSum, Program } kind = Program;
    int32_t each = 1;  // rows for each row of the chain
    // The sum of a RowSum, which is the builtin or a Program with the same effect (added_rows in
    // ir.h).
    struct Sum {
      int32_t width = 1;
      bool offsets = false, init = false;  // whether these arguments exist
      bool chunks = false;                 // long rows follow the rule of the builtin
      int32_t items = -1;  // position in the memory of the block; -1: in global memory
      int32_t batch = 0;   // largest number of items of a row, all loaded together; 0: kBatch at a
                           // time
      bool joins = false;  // has the items of the previous operation, and runs with it
      // Indices of argument words. The word of the items follows that of the offsets.
      int32_t source_word = 0, offsets_word = 1, init_word = 3, out_word = 4;
      auto operator<=>(const Sum&) const = default;
    } sum;
    // For each loop, the index of its table in ChainForm::tables; -1: the chain does not load it.
    std::vector<int32_t> tables;
    int32_t program = 0;  // index into PersistentTable::programs
    struct Source {
      // Which rows an operation reads, and where. Memory: any rows. There: only rows that exist.
      // Own: only its own row, which exists. First: only row 0, which exists, and which no
      // operation of the persistent kernel writes. Registers: the result of an earlier operation of
      // the chain.
      enum From : int32_t { Memory, There, Own, First, Registers } from = Memory;
      int32_t op = 0, output = 0;  // Registers: the operation of the chain and its output
      bool aligned = false;        // Own: the words are aligned to 16 bytes
      bool fixed =
          false;  // Own, First: no operation writes them, and they are used often enough to keep
      // Whether the source may be read before the previous phase ends: neither that phase nor the
      // chain writes it, for all chains of this form.
      bool early = false;
      bool fixed_rows = false;  // early, and no operation of the persistent kernel writes it
      // Position and number of its rows in the halo; -1: the rows are in global memory.
      int32_t halo = -1, halo_rows = 0;
      auto operator<=>(const Source&) const = default;
    };
    std::vector<Source> sources;
    struct Output {
      // When a result is stored. Now: at once. Later: when the chain is done. Never: a later
      // operation overwrites the result.
      enum Store : int32_t { Now, Later, Never } store = Now;
      int32_t width = 1;
      bool aligned = false;                // as for a source
      int32_t items = -1, item_width = 0;  // position of its items in the memory of the block
      int32_t halo = -1;                   // position of its row in the halo of other blocks
      auto operator<=>(const Output&) const = default;
    };
    std::vector<Output> outputs;
    int32_t first_word = 0;  // position of its arguments among the chain's
    // The word of the chain with the address of results of the early half, if a separate launch
    // computes them for all phases; -1: the early half runs in its phase.
    int32_t early_word = -1;
    auto operator<=>(const Operation&) const = default;
  };
  std::vector<Operation> operations;
  std::vector<int32_t> tables;  // word of the offsets of each CSR table; the word of the items
                                // follows
  bool sums_items = false;      // the phase adds items that the block made in the previous phase
  auto operator<=>(const ChainForm&) const = default;
};

struct PersistentTable {
  std::vector<const nova::ir::Program*> programs;  // without duplicates
  std::vector<ChainForm> forms;                    // forms of chains, without duplicates
  std::vector<uint64_t> words;                     // the records, followed by a word for the
                                                   // barrier
  uint64_t first_words = 0, most_words = 0;        // of the first and of the largest record
  uint64_t counters = 0;                           // position of the barrier's word
  uint32_t kept_words = 0;                         // words that each thread keeps between phases
  uint64_t tasks = 0;                              // position of the tasks of warps; 0: none
  uint64_t rows = 0;  // position of the rows of threads, by layout and block
  uint32_t layouts = 0, corners = 0, item_rows = 0;  // see BlockPlan
  uint32_t halo_rows = 0, halo_rounds = 0, halo_turns = 0, maker_warps = 0;
  std::vector<uint64_t> relative;  // words that hold offsets in bytes from the first word
  // Early halves that a separate launch computes: see run_job in persistent.cuh.
  uint64_t jobs = 0, job_count = 0, job_slots = 0;  // position, count, largest number of threads
  uint64_t early_bytes = 0;                         // size of the early results
  std::vector<uint64_t> early;                      // words that hold offsets in bytes into the
                                                    // early results
  bool fits = true;
  // Returns the words of a row of a source, and the argument word with its address.
  int32_t source_width(const ChainForm::Operation& op, size_t source) const;
  int64_t source_word(const ChainForm::Operation& op, size_t source) const;
  // Returns the number of words of a source that a chain loads when it begins; 0: not loaded.
  int32_t loaded_words(const ChainForm::Operation& op, size_t source) const;
  const nova::ir::Program& program(const ChainForm::Operation& op) const {
    return *programs[static_cast<size_t>(op.program)];
  }
};
// Cuts a Program of a chain into two halves (novaphy/program/cut.h). The early half reads no late
// source, so a thread can compute the half before its wait ends. If `early` has no outputs, the
// Program is not cut.
nova::ir::Cut halves_of(const PersistentTable& table, const ChainForm::Operation& op);
// Returns the number of 32-bit words that an early half writes for each row. The number is a
// multiple of four, because the late half loads four words at once.
inline uint64_t crossing_words(const nova::ir::Output& output) {
  return (output.values.size() + 3) / 4 * 4;
}

// The resources of a persistent kernel in which no thread has more than one row of a phase.
struct PersistentCapacity {
  uint32_t warps = 0;       // warps per phase
  uint32_t kept_words = 0;  // words that a thread may keep
  uint32_t blocks = 0;      // 0: warps have no tasks
  // Phases alternate among this number of groups of warps. While one group works, the next group
  // computes its early part.
  uint32_t groups = 1;
  const BlockPlan* plan = nullptr;
  uint64_t early_bytes = 0;  // memory for early results
};
PersistentTable persistent_table(std::span<const novaphy_persistent_op> ops,
                                 const PersistentCapacity& capacity = {});
// Returns the number of warps of the largest phase, if each thread has one row.
uint32_t most_warps(std::span<const novaphy_persistent_op> ops);

constexpr unsigned kMostInCluster = 8;  // blocks of a cluster; all devices with clusters support
                                        // this size
struct PersistentShape {
  enum class Form : uint8_t { Block, Cluster, Grid } form = Form::Block;
  unsigned blocks = 1, threads = 128;
  unsigned groups = 1;  // groups of warps, among which phases alternate
  bool is_large() const { return form == Form::Cluster && blocks > kMostInCluster; }
};
std::string persistent_source(const PersistentTable& table, const PersistentShape& shape);
// Return the shared memory per block: the static part in the text, and the part that a launch adds.
uint64_t shared_bytes(const PersistentTable& table, const PersistentShape& shape);
uint64_t launch_bytes(const PersistentTable& table, const PersistentShape& shape);

}  // namespace novaphy::gpu
