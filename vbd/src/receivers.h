// Gather lists of particles: which terms, computed by slots, are added to which particle.
#pragma once

#include <cstdint>
#include <vector>

#include "color_slots.h"

namespace novaphy::vbd {

// A term is a vector that a slot computes for the position of one corner of its element. The slots
// of all roles share one table of terms. A slot has three rows of lanes for each other corner of
// its element. With `own_terms` three rows for the slot's own corner come first.
//
// Each color has one row for every particle that receives terms from the slots of that color. With
// `own_terms` the particles of the color have rows, too. A row lists entries. An entry is the index
// of a term, whose three components are `lanes` apart. The first entries of a row belong to the
// particle's own slots, the remaining entries to slots of other particles. Both parts have the
// order of role, element and corner. This order does not depend on the groups of particles.
struct Receivers {
  void build(const ColorSlots& slots, int32_t particle_count, bool own_terms);

  std::vector<int64_t> terms_begin;  // for each role: its first term; then the end
  std::vector<int64_t> color_begin;  // for each color: its first row; then the end
  std::vector<int32_t> particle, is_own;
  // begin: the first entry of each row, then the end. others: the first entry of other slots.
  std::vector<int64_t> begin, others, entries;
};

}  // namespace novaphy::vbd
