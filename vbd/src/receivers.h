// Gather lists: the receivers of the values that slots compute for the positions of their elements.
#pragma once

#include <cstdint>
#include <vector>

#include "color_slots.h"

namespace novaphy::vbd {

// The slots of all roles share one table of terms. A slot has three rows of lanes for each other
// particle of its element. With `own_terms` three rows for its own particle come first.
//
// Each color has one row for every particle that receives terms from the slots of that color. With
// `own_terms` the particles of the color have rows too. An entry is the index of a term, whose
// three numbers are `lanes` apart. The entries of a row begin with those of the particle's own
// slots. Each part has the order of role, element and corner, which does not depend on the groups
// of particles.
struct Receivers {
  void build(const ColorSlots& slots, int32_t particle_count, bool own_terms);

  std::vector<int64_t> terms_begin;  // by role, and one more behind the last
  std::vector<int64_t> color_begin;  // the first row of each color, and one more behind the last
  std::vector<int32_t> particle, is_own;
  std::vector<int64_t> begin, others, entries;  // `begin` has one more behind the last
};

}  // namespace novaphy::vbd
