// Contacts that begin in a step, for gradients of the motion (diff_articulation_motion.h).
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "novaphy/dynamics/motion_events.h"
#include "novaphy/math/types.h"

namespace novaphy {

// Contacts of an island that hit in a step: they push, their points approach, and they did not
// push in the step before, or they bounce. Those of a group are of two bodies and along one normal,
// or one limit of a joint as a row.
struct ContactEvent {
  struct Group {
    // {dofs of the trees, one after the other}: dp = sum J_n^T lambda_n, by which it delays, and
    // -M^-1 J^T lambda of all of its rows.
    std::vector<float> normal_push, push;
    float approach = 0.0f;  // |dp . qd|
    // Of its rows, weighed by their normal impulses.
    float impulse = 0.0f, gap = 0.0f;  // N s, N s m
    int32_t shape0 = -1, shape1 = -1;  // of the first one
    int32_t dof = -1;                  // of the limit; its impulse counts as 1, and has no `push`
    MotionFriction friction = MotionFriction::None;
    bool lands = false;
    std::shared_ptr<MotionEvent> told = {};
  };
  std::vector<int32_t> trees;
  std::vector<Group> groups;
  // A row closes its gap in the step without a bounce: the event ends a step later.
  bool lands = false;
  bool has_limit() const {
    return std::any_of(groups.begin(), groups.end(), [](const Group& g) { return g.dof >= 0; });
  }
  // Several pairs at once, none of which lands: each has a delay of its own.
  bool is_apart() const { return groups.size() > 1 && !lands && !has_limit(); }
  // Whether the order of its pairs and limits decides.
  bool has_several() const { return is_apart() || (groups.size() > 1 && has_limit()); }
};
// A row that lands, with the direction of its friction: the tangential by the normal impulse.
struct LandedRow {
  int32_t shape0 = -1, shape1 = -1, point = -1;
  size_t event = 0, group = 0;
  Vec3f slip{};
};
struct ContactEvents {
  std::vector<ContactEvent> events;
  std::vector<int32_t> hits;    // rows of the contacts, ascending
  std::vector<char> touched;    // {trees}: contacts push it; empty: none
  std::vector<int32_t> root;    // {trees}: the first of its island; empty: each is its own
  std::vector<int32_t> limits;  // dofs whose limits hit
  std::vector<LandedRow> landed;
  // Events and groups of the step before that landed and whose friction has turned: it slides along
  // another direction, or did not slide before.
  std::vector<std::pair<size_t, size_t>> turned;
};

}  // namespace novaphy
