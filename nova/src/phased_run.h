// Internal: runs a stretch of recorded operations that read one another's rows on the host, phase
// by phase. Threads share the rows of all operations of a phase, and meet once before the next one.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "novaphy/nova/op_list.h"

namespace nova::detail {

// Whether an operation can be one of a phase: what it touches is known, and its rows can be shared
// out, unless it is small.
bool fits_phases(const OpList::Op& op, std::span<const uint64_t> words,
                 std::span<const MemoryAccess> accesses);

class PhasedRun {
 public:
  // Puts the operations in the order of phases and chains. They and `words`, those of the recorded
  // list, outlive this and stay as they are then.
  PhasedRun(const novaphy::DeviceContext& context, std::span<OpList::Op> ops,
            std::span<const uint64_t> words, std::span<const MemoryAccess> accesses);
  // Throws like a launch: of the operations that fail in the first phase that has any, the one that
  // was recorded first is named.
  void run() const;
  size_t phases() const { return ends_.size(); }

 private:
  // Operations [first, last), one after another for each part of the rows.
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
  int64_t threads_ = 1;          // that the rows are shared out to
  std::vector<uint32_t> order_;  // when each was recorded
  std::vector<Chain> chains_;
  std::vector<Chunk> chunks_;
  std::vector<int64_t> ends_;  // of the chunks of each phase
};

}  // namespace nova::detail
