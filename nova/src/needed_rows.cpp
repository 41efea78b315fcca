#include "needed_rows.h"

#include <algorithm>

namespace nova::detail {

namespace {

// All parts together may compute so many times the elements. Three times was still faster than to
// meet, with sixteen threads.
constexpr int64_t kMostTimes = 4;
constexpr int64_t kMargins = 8;  // that are tried

int64_t in_groups(int64_t rows) { return (rows + kGroupRows - 1) / kGroupRows * kGroupRows; }

}  // namespace

std::vector<std::vector<int32_t>> rows_needed(std::span<const Gathering> gatherings,
                                              std::span<const Shares> shares, int64_t n) {
  const uint32_t parts = shares[0].parts;
  std::vector<std::vector<int32_t>> lists(parts);
  std::vector<uint32_t> needed_by(static_cast<size_t>(n), parts);  // the part that came last
  int64_t different = 0, all = 0;
  for (uint32_t part = 0; part < parts; ++part) {
    std::vector<int32_t>& list = lists[part];
    for (size_t g = 0; g < gatherings.size(); ++g) {
      const auto& [offsets, items, sums, per_row] = gatherings[g];
      const int32_t end = offsets[shares[g].begin(sums, part + 1)];
      for (int32_t k = offsets[shares[g].begin(sums, part)]; k < end; ++k) {
        const int32_t row = items[k] / per_row;
        if (items[k] < 0 || row >= n) return {};
        uint32_t& last = needed_by[static_cast<size_t>(row)];
        if (last == part) continue;
        different += last == parts ? 1 : 0;
        last = part;
        list.push_back(row);
      }
    }
    if (list.empty()) return {};
    std::sort(list.begin(), list.end());
    list.resize(static_cast<size_t>(std::min(n, in_groups(static_cast<int64_t>(list.size())))),
                list.back());
    all += static_cast<int64_t>(list.size());
  }
  // An element that no sum needs may still be one that fails.
  if (all > kMostTimes * n || different != n) return {};
  return lists;
}

std::vector<int32_t> items_among(const Gathering& gathering, int64_t first, int64_t last,
                                 std::span<const int32_t> list) {
  std::vector<int32_t> items;
  for (int32_t k = gathering.offsets[first]; k < gathering.offsets[last]; ++k) {
    const int32_t row = gathering.items[k] / gathering.per_row;
    const auto place = std::lower_bound(list.begin(), list.end(), row) - list.begin();
    items.push_back(static_cast<int32_t>(place) * gathering.per_row +
                    gathering.items[k] % gathering.per_row);
  }
  return items;
}

Shares even_shares(std::span<const Demand> demands, Shares shares) {
  if (shares.parts < 3 || shares.whole != 1) return shares;
  Shares best = shares;
  int64_t least = 0;
  for (int64_t k = 0; k <= kMargins; ++k) {
    shares.margin = demands[0].gathering.sums * k / (kMargins * shares.parts);
    std::vector<int64_t> work(shares.parts);
    for (const Demand& demand : demands) {
      const auto lists = rows_needed({&demand.gathering, 1}, {&shares, 1}, demand.n);
      if (lists.empty()) return best;  // or with so much for the parts at the ends
      for (uint32_t part = 0; part < shares.parts; ++part)
        work[part] += demand.weight * static_cast<int64_t>(lists[part].size());
    }
    const int64_t most = *std::max_element(work.begin(), work.end());
    if (k != 0 && most >= least) continue;
    least = most;
    best = shares;
  }
  return best;
}

}  // namespace nova::detail
