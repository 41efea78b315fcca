// Contacts that begin in a step, for gradients of the motion (diff_articulation_motion.h).
#pragma once

#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "novaphy/dynamics/motion_events.h"
#include "novaphy/math/types.h"

namespace novaphy {

// Contacts of an island that hit in a step: they push, their points approach, and they did not
// push in the step before, or they bounce. Those of a group are of two bodies and along one normal.
struct ContactEvent {
  struct Group {
    // {dofs of the trees, one after the other}: dp = sum J_n^T lambda_n, by which it delays, and
    // -M^-1 J^T lambda of all of its rows.
    std::vector<float> normal_push, push;
    float approach = 0.0f;  // |dp . qd|
    // Of its rows, weighed by their normal impulses.
    float impulse = 0.0f, gap = 0.0f;  // N s, N s m
    int32_t shape0 = -1, shape1 = -1;  // of the first one
    MotionFriction friction = MotionFriction::None;
    bool lands = false;
    std::shared_ptr<MotionEvent> told = {};
  };
  std::vector<int32_t> trees;
  std::vector<Group> groups;
  // A row closes its gap in the step without a bounce: the event ends a step later.
  bool lands = false;
};
// A row that lands, with the direction of its friction: the tangential by the normal impulse.
struct LandedRow {
  int32_t shape0 = -1, shape1 = -1, point = -1;
  size_t event = 0, group = 0;
  Vec3f slip{};
};
struct ContactEvents {
  std::vector<ContactEvent> events;
  std::vector<int32_t> hits;  // rows of the contacts, ascending
  std::vector<char> touched;  // {trees}: contacts push it; empty: none
  std::vector<LandedRow> landed;
  // Events and groups of the step before that landed and whose friction has turned: it slides along
  // another direction, or did not slide before.
  std::vector<std::pair<size_t, size_t>> turned;
};

}  // namespace novaphy
