// Sweeps of several islands of the same structure at once, one per lane (island_sweeps.h).
#pragma once

#include <cstdint>

#include "novaphy/dynamics/articulation/islands.h"

namespace novaphy::articulation {

// Islands without dry friction, with the same number of trees and of complete contacts. A contact
// joins trees of the same places in each island.
struct LaneIslands {
  int32_t count = 0;  // islands, at most one per lane
  int32_t rows = 0, trees = 0;
  IslandContact* const* contacts = nullptr;  // {count}: the contacts of each island
  float* const* rates = nullptr;             // {count, trees}: IslandTree::rates
  const int32_t* widths = nullptr;           // {trees}: padded_dofs
  const int32_t* moves = nullptr;            // {trees}: whether impulses move the tree
  bool cone = true;
  int32_t most_sweeps = 1;
  float tolerance = 0.0f;
  // {count}: sweeps continue after as many as `sweeps`, which is the same for all islands.
  IslandResult* const* results = nullptr;
  void* memory = nullptr;  // aligned to 64 bytes
};

}  // namespace novaphy::articulation
