// Contacts that begin in a step, for gradients of the motion (diff_articulation_motion.h).
#pragma once

#include <cstdint>
#include <vector>

namespace novaphy {

// Contacts of an island that hit in a step: they push, their points approach, and they did not
// push in the step before, or they bounce. Those of a group are of two bodies and along one normal.
struct ContactEvent {
  struct Group {
    // {dofs of the trees, one after the other}: dp = sum J_n^T lambda_n, by which it delays, and
    // -M^-1 J^T lambda of all of its rows.
    std::vector<float> normal_push, push;
    float approach = 0.0f;  // |dp . qd|
  };
  std::vector<int32_t> trees;
  std::vector<Group> groups;
  // A row closes its gap in the step without a bounce: the event ends a step later.
  bool lands = false;
};
struct ContactEvents {
  std::vector<ContactEvent> events;
  std::vector<int32_t> hits;  // rows of the contacts, ascending
  std::vector<char> touched;  // {trees}: contacts push it; empty: none
};

}  // namespace novaphy
