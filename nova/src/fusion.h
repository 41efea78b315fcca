// Internal: running many recorded operations block by block of rows, so that a block's data stays
// in the cache from one operation to the next. Possible while every operation touches written
// memory at its own row only.
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
    uint32_t word;       // argument word that holds a pointer
    uint32_t row_bytes;  // bytes per row
  };
  bool row_local = false;     // the row number is used for nothing but direct reads and writes
  bool of_builtin = false;    // whose launches declare all that they touch; else a Program
  uint32_t operations = 1;    // of a row, about
  std::vector<Word> inputs;   // advanced by the row
  std::vector<Word> outputs;  // advanced by the row
  std::vector<Word> tables;   // advanced by the row; offsets of CSR rows, items in the word after
  std::vector<Word> indices;  // i32 sources
  std::vector<Word> shared;   // read at other rows; the word after it is the number of rows
};
RowLayout row_layout(const ir::Program& program);

// A stretch of operations; n > 0: to be run block by block over n rows, `block_rows` at a time. An
// operation over m * n rows has m rows there for each.
struct Segment {
  uint32_t first = 0, last = 0;
  int64_t n = 0;
  int64_t block_rows = 0;
};

// The rows of an operation: of a copy or fill its 32-bit words.
inline int64_t rows_of(const OpList::Op& op) {
  return op.kind == OpList::Op::Kind::Launch ? op.n : op.n / 4;
}
// Whether the operation finds CSR rows by what is at this address.
bool is_table(const OpList::Op& op, std::span<const uint64_t> words, uint64_t address);
// Adds what an operation touches; false: that is not known.
bool touched_by(const OpList::Op& op, std::span<const uint64_t> words,
                std::span<const MemoryAccess> accesses, std::vector<MemoryAccess>& touched);

// The operations in an order that gives the same results, cut into segments. What stands in the
// way of a segment is run before it or after it where no data forbids that: a loss that sums over
// all rows does not part the forward rollout of a block from its backward one.
struct RunPlan {
  std::vector<OpList::Op> ops;
  std::vector<Segment> segments;
};
inline constexpr uint32_t kMaxFusedWords = 192;  // argument words of a launch that can be fused
// What a segment may be made of.
struct PlanLimits {
  int64_t min_rows = 2048;
  bool multiples = true;  // operations that have several rows for each row of the segment
  // Launches of one kernel, one after the other, that make a segment of any number of rows; 0:
  // none.
  uint32_t min_scan = 0;
};
// Sets tables_change. Whoever plans by what tables hold needs it: a launch may find something else
// there.
void mark_changing_tables(std::span<OpList::Op> ops, std::span<const uint64_t> words,
                          std::span<const MemoryAccess> accesses);
RunPlan plan_run(std::span<const OpList::Op> ops, std::span<const uint64_t> words,
                 std::span<const MemoryAccess> accesses, const PlanLimits& limits = {});

// Runs the rows [begin, begin + rows) of n that an operation can be cut into; a launch over m * n
// rows has m there for each. OK, or the backend's status and message.
novaphy_status run_rows(const novaphy::DeviceContext& context, const OpList::Op& op,
                        const uint64_t* words, int64_t n, int64_t begin, int64_t rows,
                        novaphy_error& error);

// Throws what an operation fails with. The message of a part of its rows counts from the first of
// them, so the operation is asked once more as a whole; `error` is what the part said.
void fail_as_a_whole(const novaphy::DeviceContext& context, const OpList::Op& op,
                     const uint64_t* words, novaphy_status status, const novaphy_error& error);

class PhasedRun;

// A plan made ready to run on a device whose memory the host may dereference: launches of one
// kernel that stand together in a segment become one call, where the backend can do that, and what
// is in no long segment becomes phases.
class HostPlan {
 public:
  // `words`: of the recorded list; they outlive the plan and stay as they are. `phases`: whether
  // there are any, which pays for lists that run many times.
  HostPlan(const novaphy::DeviceContext& context, RunPlan plan, std::span<const uint64_t> words,
           std::span<const MemoryAccess> accesses, bool phases);
  ~HostPlan();
  HostPlan(const HostPlan&) = delete;
  HostPlan& operator=(const HostPlan&) = delete;
  // Throws like a launch.
  void run() const;

  struct Scan {
    uint32_t first, last;  // operations
    novaphy_scan* scan;
  };

 private:
  void make_scan(std::span<const MemoryAccess> accesses);
  void make_phases(std::span<const MemoryAccess> accesses);
  void print(std::span<const MemoryAccess> accesses) const;  // to the standard error
  void cut_into_phases(uint32_t first, uint32_t last, std::span<const MemoryAccess> accesses,
                       std::vector<Segment>& cut);

  const novaphy::DeviceContext& context_;
  std::vector<OpList::Op> ops_;
  std::vector<Segment> segments_;
  const std::span<const uint64_t> words_;
  std::vector<Scan> scans_;                                // in order
  std::map<uint32_t, std::unique_ptr<PhasedRun>> phases_;  // by the first operation of a segment
};

}  // namespace nova::detail
