#include "receivers.h"

#include <numeric>

namespace novaphy::vbd {

void Receivers::build(const ColorSlots& slots, int32_t particle_count) {
  struct Sent {
    size_t row;
    Entry entry;
  };
  particles_ = static_cast<size_t>(particle_count);
  const std::vector<int64_t>& colors = slots.color_begin();
  std::vector<size_t> color_of;  // of a group
  for (size_t c = 0; c + 1 < colors.size(); ++c)
    color_of.resize(static_cast<size_t>(colors[c + 1]), c);
  std::vector<Sent> all;
  const auto lanes = static_cast<int64_t>(slots.lanes());
  for (int role = 0; role < kRoles; ++role) {
    const ColorSlots::Table& table = slots.table(static_cast<Role>(role));
    std::vector<size_t> group_of;  // of a slot
    for (size_t g = 0; g + 1 < table.begin.size(); ++g)
      group_of.resize(static_cast<size_t>(table.begin[g + 1]), g);
    for (const int64_t place : table.places) {
      if (place < 0) continue;
      const int64_t slot = place / lanes, lane = place % lanes;
      const size_t color = color_of[group_of[static_cast<size_t>(slot)]];
      for (int k = 0; k < kOthers[role]; ++k) {
        const int row = kOwnPlace[role] < 0 || k < kOwnPlace[role] ? k : k + 1;
        const int32_t particle =
            table.ints[static_cast<size_t>((slot * kInts[role] + row) * lanes + lane)];
        all.push_back({color * particles_ + static_cast<size_t>(particle),
                       {role, (slot * kOthers[role] + k) * 3 * lanes + lane}});
      }
    }
  }
  begin_.assign((colors.size() - 1) * particles_ + 1, 0);
  for (const Sent& sent : all) ++begin_[sent.row + 1];
  std::partial_sum(begin_.begin(), begin_.end(), begin_.begin());
  entries_.resize(all.size());
  std::vector<size_t> next = begin_;
  for (const Sent& sent : all) entries_[next[sent.row]++] = sent.entry;
}

}  // namespace novaphy::vbd
