// IndexRows: the inverse of a list of integers. items(k) are the positions of the list that hold k,
// in ascending order. Negative entries belong to no row.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "novaphy/core/assert.h"

namespace novaphy {

class IndexRows {
 public:
  // Builds the rows by a stable counting sort. Entries must be less than `rows`. Memory is reused.
  void build(std::span<const int32_t> entries, int32_t rows) {
    begin_.assign(static_cast<size_t>(rows) + 1, 0);
    size_t present = 0;
    for (const int32_t entry : entries) {
      if (entry < 0) continue;
      NOVAPHY_ASSERT(entry < rows);
      ++begin_[static_cast<size_t>(entry) + 1];
      ++present;
    }
    for (size_t k = 1; k < begin_.size(); ++k) begin_[k] += begin_[k - 1];
    items_.resize(present);
    for (size_t place = 0; place < entries.size(); ++place) {
      if (entries[place] < 0) continue;
      // begin_[k] is a cursor in this loop and ends at the end of row k. The next loop restores the
      // starts.
      items_[static_cast<size_t>(begin_[static_cast<size_t>(entries[place])]++)] =
          static_cast<int32_t>(place);
    }
    for (size_t k = begin_.size() - 1; k > 0; --k) begin_[k] = begin_[k - 1];
    begin_[0] = 0;
    NOVAPHY_ASSERT(begin_.back() == static_cast<int64_t>(present));
  }
  void clear() { items_.clear(); }

  bool empty() const { return items_.empty(); }
  // All items, row after row. Row k begins at begins()[k].
  std::span<const int32_t> all() const { return items_; }
  std::span<const int32_t> begins() const { return begin_; }
  std::span<const int32_t> items(int64_t row) const {
    const int32_t begin = begin_[static_cast<size_t>(row)];
    const int32_t end = begin_[static_cast<size_t>(row) + 1];
    return {items_.data() + begin, static_cast<size_t>(end - begin)};
  }

 private:
  std::vector<int32_t> begin_;  // rows + 1
  std::vector<int32_t> items_;
};

}  // namespace novaphy
