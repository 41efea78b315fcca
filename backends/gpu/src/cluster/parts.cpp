#include "cluster/parts.h"

#include <algorithm>
#include <map>
#include <utility>

namespace novaphy::gpu {
namespace {

constexpr int kMostSweeps = 32;
constexpr size_t kMoreRows = 2;  // rows of a part beyond an even share

void make_set(RowList& rows) {
  std::sort(rows.begin(), rows.end());
  rows.erase(std::unique(rows.begin(), rows.end()), rows.end());
}

class Cutter {
 public:
  Cutter(std::vector<RowList> needs, uint32_t count, uint32_t parts)
      : parts_(parts), needs_(std::move(needs)), needed_by_(count), part_(needs_.size(), parts) {
    for (uint32_t row = 0; row < needs_.size(); ++row) {
      make_set(needs_[row]);
      for (const uint32_t need : needs_[row]) needed_by_[need].push_back(row);
    }
  }

  RowList run() {
    grow();
    even_out();
    return std::move(part_);
  }

 private:
  bool is_free(uint32_t row) const { return part_[row] == parts_; }

  // Fills one part after the other. The next row is the row that adds the fewest needs to the part.
  void grow() {
    RowList last_part(needed_by_.size(), parts_);  // the last part that has each need
    size_t left = part_.size();
    for (uint32_t part = 0; part < parts_; ++part) {
      RowList edge;  // rows that share a need with the part
      for (size_t room = (left + parts_ - part - 1) / (parts_ - part); room > 0; --room, --left) {
        std::erase_if(edge, [&](uint32_t row) { return !is_free(row); });
        const uint32_t row = next_row(edge, last_part, part);
        part_[row] = part;
        for (const uint32_t need : needs_[row]) {
          if (std::exchange(last_part[need], part) == part) continue;
          for (const uint32_t other : needed_by_[need])
            if (is_free(other) && std::find(edge.begin(), edge.end(), other) == edge.end())
              edge.push_back(other);
        }
      }
    }
  }
  // Begins a part with the row that has the fewest unassigned neighbors, which lies at the border.
  uint32_t next_row(const RowList& edge, const RowList& last_part, uint32_t part) const {
    uint32_t best = UINT32_MAX;
    std::pair<size_t, size_t> least;
    const auto look_at = [&](uint32_t row) {
      size_t more = 0, free = 0;
      for (const uint32_t need : needs_[row]) {
        more += last_part[need] != part ? 1 : 0;
        for (const uint32_t other : needed_by_[need]) free += is_free(other) ? 1 : 0;
      }
      const std::pair here = edge.empty() ? std::pair{free, more} : std::pair{more, free};
      if (best != UINT32_MAX && (here > least || (here == least && row > best))) return;
      best = row;
      least = here;
    };
    for (const uint32_t row : edge) look_at(row);
    if (edge.empty())
      for (uint32_t row = 0; row < part_.size(); ++row)
        if (is_free(row)) look_at(row);
    return best;
  }

  // Moves rows to other parts while that reduces the sum of the squared numbers of the parts'
  // needs.
  void even_out() {
    uses_.resize(parts_);
    std::vector<size_t> size(parts_, 0);
    for (uint32_t row = 0; row < part_.size(); ++row) {
      ++size[part_[row]];
      for (const uint32_t need : needs_[row]) ++uses_[part_[row]][need];
    }
    const size_t most = (part_.size() + parts_ - 1) / parts_ + kMoreRows;
    bool moved = true;
    for (int sweep = 0; moved && sweep < kMostSweeps; ++sweep) {
      moved = false;
      for (uint32_t row = 0; row < part_.size(); ++row) {
        const uint32_t from = part_[row], to = size[from] > 1 ? better_part(row, size, most) : from;
        if (to == from) continue;
        for (const uint32_t need : needs_[row]) {
          const auto use = uses_[from].find(need);
          if (--use->second == 0) uses_[from].erase(use);
          ++uses_[to][need];
        }
        --size[from];
        ++size[to];
        part_[row] = to;
        moved = true;
      }
    }
  }
  uint32_t better_part(uint32_t row, const std::vector<size_t>& size, size_t most) const {
    const uint32_t from = part_[row];
    size_t less = 0;
    RowList neighbors;
    for (const uint32_t need : needs_[row]) {
      less += uses_[from].at(need) == 1 ? 1 : 0;
      for (const uint32_t other : needed_by_[need]) neighbors.push_back(part_[other]);
    }
    make_set(neighbors);
    const auto square = [](size_t n) { return static_cast<int64_t>(n * n); };
    int64_t best = 0;
    uint32_t to = from;
    for (const uint32_t part : neighbors) {
      if (part == from || size[part] >= most) continue;
      size_t more = 0;
      for (const uint32_t need : needs_[row]) more += uses_[part].contains(need) ? 0 : 1;
      const size_t a = uses_[from].size(), b = uses_[part].size();
      const int64_t change = square(a - less) + square(b + more) - square(a) - square(b);
      if (change >= best) continue;
      best = change;
      to = part;
    }
    return to;
  }

  const uint32_t parts_;
  std::vector<RowList> needs_, needed_by_;
  RowList part_;                                    // part of each row; parts_: not assigned
  std::vector<std::map<uint32_t, uint32_t>> uses_;  // for each part: its needs, and the number of
                                                    // rows that have each
};

}  // namespace

RowList parts_of(std::vector<RowList> needs, uint32_t count, uint32_t parts) {
  return Cutter(std::move(needs), count, parts).run();
}

}  // namespace novaphy::gpu
