// Internal: which rows of elements each part of the sums over them needs.
#pragma once

#include <compare>
#include <cstdint>
#include <span>
#include <vector>

namespace nova::detail {

inline constexpr int64_t kGroupRows = 16;  // that compiled code computes together, at most

// How rows are shared out to parts.
struct Shares {
  uint32_t parts = 1;
  int64_t whole = kGroupRows;  // a part begins at a multiple of it
  int64_t margin = 0;          // so many rows more for the first part and for the last

  int64_t begin(int64_t rows, uint32_t part) const {
    if (part == 0 || part == parts) return part == 0 ? 0 : rows;
    return (margin + (rows - 2 * margin) * part / parts) / whole * whole;
  }
};

// Sums whose row r adds the items from offsets[r] to offsets[r + 1]; a row of elements is so many
// items.
struct Gathering {
  const int32_t *offsets, *items;
  int64_t sums;
  int32_t per_row;
  auto operator<=>(const Gathering&) const = default;
};

// The rows of `n` elements that each part of these sums needs, in their order, in whole groups as
// far as there are rows. Empty when the parts together need too many, or not every row.
std::vector<std::vector<int32_t>> rows_needed(std::span<const Gathering> gatherings,
                                              std::span<const Shares> shares, int64_t n);

// The items of the sums from `first` to `last`, where the elements are those of the list alone.
std::vector<int32_t> items_among(const Gathering& gathering, int64_t first, int64_t last,
                                 std::span<const int32_t> list);

// Elements that one kind of sum needs, and the work of one.
struct Demand {
  Gathering gathering;
  int64_t n, weight;
};
// Shares of the rows of these sums with which the part that needs most elements needs few: those at
// both ends have neighbours on one side only.
Shares even_shares(std::span<const Demand> demands, Shares shares);

}  // namespace nova::detail
