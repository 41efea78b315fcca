// Internal: runs many recorded operations block by block of rows, so that the data of a block stays
// in the cache from one operation to the next. This is valid while every operation accesses written
// memory only at its own row.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <span>
#include <vector>

#include "novaphy/nova/op_list.h"
#include "novaphy/program/ir.h"

namespace nova::detail {

// How the arguments of a Program depend on the row.
struct RowLayout {
  struct Word {
    uint32_t word;       // index of the argument word with the pointer
    uint32_t row_bytes;  // bytes per row
  };
  bool row_local = false;     // whether the row index serves only direct reads and writes
  bool of_builtin = false;    // a builtin, whose launches declare all accesses; else a Program
  uint32_t operations = 1;    // approximate number of operations per row
  std::vector<Word> inputs;   // pointers that advance with the row
  std::vector<Word> outputs;  // pointers that advance with the row
  std::vector<Word> tables;   // pointers that advance with the row: offsets of CSR rows; the next
                              // word has the items
  std::vector<Word> indices;  // i32 sources
  std::vector<Word> shared;   // read at other rows; the next word is the number of rows
};
RowLayout row_layout(const ir::Program& program);

// Consecutive operations. If n > 0, they run block by block over n rows, `block_rows` at a time. An
// operation over m * n rows has m rows for each of the n rows.
struct Segment {
  uint32_t first = 0, last = 0;
  int64_t n = 0;
  int64_t block_rows = 0;
};

// Returns the number of rows of an operation; for a copy or fill, the number of its 32-bit words.
inline int64_t rows_of(const OpList::Op& op) {
  return op.kind == OpList::Op::Kind::Launch ? op.n : op.n / 4;
}
// Returns whether the operation reads CSR offsets or items at this address.
bool is_table(const OpList::Op& op, std::span<const uint64_t> words, uint64_t address);
// Appends the accesses of an operation. Returns false if they are unknown.
bool touched_by(const OpList::Op& op, std::span<const uint64_t> words,
                std::span<const MemoryAccess> accesses, std::vector<MemoryAccess>& touched);

// The operations in an order with the same results, divided into segments. An operation that would
// split a segment moves before or after the segment if the data flow allows it. For example, a loss
// that sums over all rows does not separate the forward rollout of a block from its backward pass.
struct RunPlan {
  std::vector<OpList::Op> ops;
  std::vector<Segment> segments;
};
inline constexpr uint32_t kMaxFusedWords = 192;  // largest number of argument words of a fused
                                                 // launch
// Limits on the operations of a segment.
struct PlanLimits {
  int64_t min_rows = 2048;
  bool multiples = true;  // allow operations with several rows per row of the segment
  // Consecutive launches of one kernel make a segment for any number of rows if the list has at
  // least this many of them; 0: never.
  uint32_t min_scan = 0;
};
// Sets Op::tables_change. Plans that depend on the contents of tables need the flag, because the
// table may have other contents at the launch.
void mark_changing_tables(std::span<OpList::Op> ops, std::span<const uint64_t> words,
                          std::span<const MemoryAccess> accesses);
RunPlan plan_run(std::span<const OpList::Op> ops, std::span<const uint64_t> words,
                 std::span<const MemoryAccess> accesses, const PlanLimits& limits = {});

// Runs the part [begin, begin + rows) of n rows of an operation. A launch over m * n rows has m
// rows for each of the n rows. Returns OK, or the status and message of the backend.
novaphy_status run_rows(const novaphy::DeviceContext& context, const OpList::Op& op,
                        const uint64_t* words, int64_t n, int64_t begin, int64_t rows,
                        novaphy_error& error);

// Throws the error of an operation. An error message about a part of the rows counts from the first
// row of the part, so the whole operation runs once more to get the right message. `error` is the
// message of the part.
void fail_as_a_whole(const novaphy::DeviceContext& context, const OpList::Op& op,
                     const uint64_t* words, novaphy_status status, const novaphy_error& error);

class PhasedRun;

// A plan that is ready to run on a device whose memory the host can access. Consecutive launches of
// one kernel in a segment become one call if the backend supports it. Operations outside of long
// segments become phases.
class HostPlan {
 public:
  // `words`: the words of the recorded list, which outlive the plan unchanged. `phases`: whether to
  // make phases, which pays off for lists that run many times.
  HostPlan(const novaphy::DeviceContext& context, RunPlan plan, std::span<const uint64_t> words,
           std::span<const MemoryAccess> accesses, bool phases);
  ~HostPlan();
  HostPlan(const HostPlan&) = delete;
  HostPlan& operator=(const HostPlan&) = delete;
  // Throws like a launch.
  void run() const;

  struct Scan {
    uint32_t first, last;  // operations [first, last)
    novaphy_scan* scan;
  };

 private:
  void make_scan(std::span<const MemoryAccess> accesses);
  void make_phases(std::span<const MemoryAccess> accesses);
  void print(std::span<const MemoryAccess> accesses) const;  // prints to the standard error
  void cut_into_phases(uint32_t first, uint32_t last, std::span<const MemoryAccess> accesses,
                       std::vector<Segment>& cut);

  const novaphy::DeviceContext& context_;
  std::vector<OpList::Op> ops_;
  std::vector<Segment> segments_;
  const std::span<const uint64_t> words_;
  std::vector<Scan> scans_;                                // in order
  // keyed by the first operation of a segment
  std::map<uint32_t, std::unique_ptr<PhasedRun>> phases_;
};

}  // namespace nova::detail
