#include "receivers.h"

#include <algorithm>
#include <numeric>

#include "novaphy/core/assert.h"

namespace novaphy::vbd {

void Receivers::build(const ColorSlots& slots, int32_t particle_count, bool own_terms) {
  struct Sent {
    size_t place;
    int64_t entry;
  };
  const auto particles = static_cast<size_t>(particle_count);
  const std::vector<int64_t>& colors = slots.color_begin();
  const size_t color_count = colors.size() - 1;
  const std::vector<int32_t>& lane_particle = slots.particles();
  std::vector<size_t> color_of;  // of each group
  for (size_t c = 0; c < color_count; ++c) color_of.resize(static_cast<size_t>(colors[c + 1]), c);
  // The terms of each particle and color: first from its own slots, then from other slots.
  std::vector<Sent> all;
  const auto lanes = static_cast<int64_t>(slots.lanes());
  terms_begin.assign(1, 0);
  for (int role = 0; role < kRoles; ++role) {
    const ColorSlots::Table& table = slots.table(role);
    const int64_t first = terms_begin.back();
    const int own = own_terms ? 1 : 0, points = kOthers[role] + own;
    std::vector<size_t> group_of;  // of each slot
    for (size_t g = 0; g + 1 < table.begin.size(); ++g)
      group_of.resize(static_cast<size_t>(table.begin[g + 1]), g);
    terms_begin.push_back(first + static_cast<int64_t>(table.sources.size()) * 3 * points);
    for (const int64_t place : table.places) {
      if (place < 0) continue;
      const int64_t slot = place / lanes, lane = place % lanes;
      const size_t group = group_of[static_cast<size_t>(slot)];
      const auto send = [&](int point, int32_t to, size_t is_other) {
        all.push_back({2 * (color_of[group] * particles + static_cast<size_t>(to)) + is_other,
                       first + (slot * points + point) * 3 * lanes + lane});
      };
      if (own_terms)
        send(0, lane_particle[group * static_cast<size_t>(lanes) + static_cast<size_t>(lane)], 0);
      for (int k = 0; k < kOthers[role]; ++k)
        send(own + k, table.ints[static_cast<size_t>((slot * kOthers[role] + k) * lanes + lane)],
             1);
    }
  }
  std::vector<int64_t> first(2 * color_count * particles + 1, 0);
  for (const Sent& sent : all) ++first[sent.place + 1];
  std::partial_sum(first.begin(), first.end(), first.begin());
  entries.resize(all.size());
  std::vector<int64_t> next = first;
  for (const Sent& sent : all) entries[static_cast<size_t>(next[sent.place]++)] = sent.entry;

  std::vector<int32_t> moves(color_count * particles, 0);
  for (size_t group = 0; own_terms && group < color_of.size(); ++group)
    for (size_t l = 0; l < static_cast<size_t>(slots.filled()[group]); ++l)
      moves[color_of[group] * particles +
            static_cast<size_t>(lane_particle[group * static_cast<size_t>(lanes) + l])] = 1;
  color_begin.assign(1, 0);
  particle.clear();
  is_own.clear();
  begin.clear();
  others.clear();
  for (size_t color = 0; color < color_count; ++color) {
    for (size_t p = 0; p < particles; ++p) {
      const size_t k = color * particles + p;
      if (moves[k] == 0 && first[2 * k] == first[2 * k + 2]) continue;
      particle.push_back(static_cast<int32_t>(p));
      is_own.push_back(moves[k]);
      begin.push_back(first[2 * k]);
      others.push_back(first[2 * k + 1]);
    }
    color_begin.push_back(static_cast<int64_t>(particle.size()));
  }
  begin.push_back(static_cast<int64_t>(entries.size()));
  NOVAPHY_ASSERT(begin.size() == particle.size() + 1 && others.size() == particle.size());
  NOVAPHY_ASSERT(std::is_sorted(begin.begin(), begin.end()));
}

}  // namespace novaphy::vbd
