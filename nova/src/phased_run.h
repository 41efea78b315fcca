// Internal: runs recorded operations that read each other's rows on the host, phase by phase.
// Threads share the rows of all operations of a phase, and meet at a barrier before the next phase.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "novaphy/nova/op_list.h"

namespace nova::detail {

// Returns whether an operation can be part of a phase: its accesses are known, and its rows can be
// split or it is small.
bool fits_phases(const OpList::Op& op, std::span<const uint64_t> words,
                 std::span<const MemoryAccess> accesses);

class PhasedRun {
 public:
  // Puts the operations into the order of phases and chains. The operations and the words of the
  // recorded list must outlive this object unchanged.
  PhasedRun(const novaphy::DeviceContext& context, std::span<OpList::Op> ops,
            std::span<const uint64_t> words, std::span<const MemoryAccess> accesses);
  // Throws like a launch. The error is that of the first phase with a failure. In this phase, it is
  // that of the operation that was recorded first.
  void run() const;
  size_t phases() const { return ends_.size(); }

 private:
  // Operations [first, last), which run one after another for each part of the rows.
  struct Chain {
    uint32_t first, last;
    uint32_t phase;
    int64_t rows;
    uint32_t parts;

    int64_t begin(uint32_t part) const;
  };
  struct Chunk {
    uint32_t chain, part;
  };
  struct Failure;
  uint32_t parts_of(std::span<const OpList::Op> chain, int64_t rows) const;
  void make_chunks();
  void run_chunk(int64_t number, Failure& failure) const;

  const novaphy::DeviceContext& context_;
  const std::span<const uint64_t> words_;
  const std::span<const OpList::Op> ops_;
  int64_t threads_ = 1;          // number of threads that share the rows
  std::vector<uint32_t> order_;  // position of each operation in the recording
  std::vector<Chain> chains_;
  std::vector<Chunk> chunks_;
  std::vector<int64_t> ends_;  // end of each phase in chunks_
};

}  // namespace nova::detail
