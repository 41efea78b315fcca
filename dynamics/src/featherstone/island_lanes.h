// Solves islands of the same structure side by side (lane_islands.h), such as those of many worlds.
#pragma once

#include <cstdint>
#include <vector>

#include "lane_islands.h"
#include "lane_step.h"
#include "novaphy/dynamics/articulation/group_step.h"

namespace novaphy {

class IslandLanes {
 public:
  // Call on the CPU, after articulation_contact_start of all trees. Solves the coupled islands
  // without dry friction of which at least three have the same structure, and marks their roots as
  // solved. The results have the bits of articulation_contact_solve.
  void solve(const ArticulationContactStepArguments& step, int64_t trees);

 private:
  struct Island {
    int32_t root;
    int64_t begin, size;  // its numbers in shapes_
    int64_t trees;        // its first tree in trees_
    articulation::IslandResult result;
  };
  void find(const ArticulationContactStepArguments& step, int64_t trees);
  void describe(const GroupStep& s, int32_t root);
  bool same(const Island& a, const Island& b) const;
  void keep_groups();
  void sweep(const ArticulationContactStepArguments& step, int32_t most_sweeps);
  void sweep_pack(const ArticulationContactStepArguments& step, int32_t most_sweeps, size_t begin,
                  size_t end);

  const articulation::LaneLevel& level_ = articulation::lane_level();
  std::vector<Island> islands_;
  // The structure of each island: the numbers of trees and contacts, then the width of each tree
  // and whether it moves, then the places of both trees of each contact.
  std::vector<int32_t> shapes_;
  std::vector<int32_t> trees_;        // of each island
  std::vector<size_t> left_, packs_;  // islands that have not converged; the first of each pack
};

}  // namespace novaphy
