// Gather lists: the receivers of the values that slots compute for the positions of their elements.
#pragma once

#include <cstdint>
#include <vector>

#include "color_slots.h"

namespace novaphy::vbd {

// Slots of all roles lie in one table of terms: for each of them three rows of lanes for every
// other particle, behind three for its own if `own_terms`.
//
// For each color there are rows, one for every particle to which slots of the particles of that
// color give something; with `own_terms` for these particles too. Entries are where terms begin,
// whose three numbers are `lanes` apart; first those of the particle's own slots, then others, each
// in the order of role, element and corner, which does not depend on how particles are grouped.
struct Receivers {
  void build(const ColorSlots& slots, int32_t particle_count, bool own_terms);

  std::vector<int64_t> terms_begin;  // by role, and behind the last
  std::vector<int64_t> color_begin;  // rows of each color, and behind the last
  std::vector<int32_t> particle, is_own;
  std::vector<int64_t> begin, others, entries;  // `begin` also behind the last
};

}  // namespace novaphy::vbd
