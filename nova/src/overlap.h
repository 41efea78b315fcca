// Internal: phases that need no meeting of the threads between them, because each part of the rows
// computes all that its own sums need. Elements near a border are computed by both sides.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "fusion.h"
#include "needed_rows.h"
#include "novaphy/nova/op_list.h"

namespace nova::detail {

// Operations [first, last), one after another for each part of the rows.
struct Chain {
  uint32_t first, last;
  uint32_t phase;
  int64_t rows;
  Shares shares;
};

// What elements write and sums gather, as forces, goes to memory of the part; and what a phase
// writes while another part may still read the value before it, to a second place. Then the phases
// of elements and of their sums can be joined: one thread does a part of both. A part has its
// elements close together, with a copy of what they read at their own rows. What is written last is
// where it was recorded, for others to see.
class Overlap {
 public:
  struct Rows {
    int64_t begin, end;
  };

  // For operations in the order of chains, and chains in the order of phases, whose numbers change
  // when phases are joined. Chains of another number of parts stay as they are. Index tables are
  // read now.
  Overlap(std::span<const OpList::Op> ops, std::span<const uint64_t> words,
          std::span<const MemoryAccess> accesses, std::span<Chain> chains, uint32_t parts);

  // Whether a part of all chains of a phase is done as one.
  bool joint(uint32_t phase) const { return joint_[phase]; }
  // Which rows of the elements that were recorded a part has, close together; empty: it does rows
  // of its own, where they are.
  std::span<const int32_t> listed(uint32_t op, uint32_t part) const {
    const uint32_t lists = changes_[op].lists;
    return lists == 0 ? std::span<const int32_t>() : lists_[lists - 1][part];
  }
  // The rows of an operation of this chain that a part does.
  Rows rows(uint32_t op, const Chain& chain, uint32_t part) const {
    const auto list = listed(op, part);
    if (!list.empty()) return {0, static_cast<int64_t>(list.size())};
    return {chain.shares.begin(chain.rows, part), chain.shares.begin(chain.rows, part + 1)};
  }
  // Copies what elements of the part read at their own rows, before the first operation that finds
  // it there.
  void copy_rows(uint32_t op, uint32_t part) const {
    const Change& c = changes_[op];
    if (c.copies != 0) [[unlikely]]
      copy_rows(std::span(copies_).subspan(c.first_copy, c.copies), part);
  }
  // The arguments that point elsewhere than was recorded.
  MovedWords moved(uint32_t op, uint32_t part) const {
    const Change& c = changes_[op];
    return {std::span(moved_).subspan(c.first, c.words), bases_.data() + part * memory_.size()};
  }
  // Those of them that are the same for all parts.
  MovedWords moved_for_all(uint32_t op) const {
    const Change& c = changes_[op];
    return {std::span(moved_).subspan(c.first, c.shared), bases_.data()};
  }

 private:
  struct Change {
    uint32_t lists = 0;             // of rows, from 1 on; 0: parts do rows of their own
    uint32_t first = 0, words = 0;  // moved; those for all parts come first
    uint32_t shared = 0;            // so many are for all parts
    uint32_t first_copy = 0, copies = 0;
  };
  // Of the rows in the lists.
  struct Copy {
    uint64_t from;
    uint32_t row_bytes, lists, memory;
  };
  using Lists = std::vector<std::vector<int32_t>>;  // a list for each part
  class Planner;
  void copy_rows(std::span<const Copy> copies, uint32_t part) const;

  const uint32_t parts_;
  std::vector<bool> joint_;
  std::vector<Change> changes_;  // by operation
  std::vector<MovedWord> moved_;
  std::vector<Lists> lists_;
  std::vector<Copy> copies_;
  std::vector<uint64_t> bases_;  // of each memory, part by part: where row 0 would be
  std::vector<std::unique_ptr<std::byte[]>> memory_;
};

}  // namespace nova::detail
