// ContactEvent: contacts that begin in a step, for gradients of the motion
// (diff_articulation_motion.h).
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <utility>
#include <vector>

#include "novaphy/dynamics/motion_events.h"
#include "novaphy/math/types.h"

namespace novaphy {

// Contacts of an island that hit in a step. A contact hits if it pushes and its points approach,
// and if it did not push in the step before or bounces. A group has the contacts of two bodies
// along one normal, or one joint limit as a constraint row.
struct ContactEvent {
  struct Group {
    // Arrays over the dofs of the event's trees, tree by tree. normal_push: dp = sum J_n^T
    // lambda_n, which determines the delay. push: -M^-1 J^T lambda of all rows of the group.
    std::vector<float> normal_push, push;
    float approach = 0.0f;  // |dp . qd|
    // Sums over the rows: the normal impulses, and the gaps times the normal impulses.
    float impulse = 0.0f, gap = 0.0f;  // N s, N s m
    int32_t shape0 = -1, shape1 = -1;  // of the first row
    int32_t dof = -1;                  // of a limit; its impulse counts as 1, and `push` is empty
    float side = 1.0f;                 // sign of the limit's gap in q: -1 for an upper limit
    bool is_cut = false;               // the bounce ends at the other limit in the same step
    int32_t points = 0;                // number of rows
    MotionFriction friction = MotionFriction::None;
    bool lands = false;
    std::shared_ptr<MotionEvent> listed = {};
  };
  std::vector<int32_t> trees;
  std::vector<Group> groups;
  // Whether a row closes its gap in the step without a bounce (a landing). The event then ends a
  // step later.
  bool lands = false;
  bool has_limit() const {
    return std::any_of(groups.begin(), groups.end(), [](const Group& g) { return g.dof >= 0; });
  }
  // Returns whether several pairs hit at once and none of them lands. Each pair then has its own
  // delay.
  bool is_apart() const { return groups.size() > 1 && !lands && !has_limit(); }
  // Whether the result depends on the order of the event's pairs, points and limits.
  bool has_several() const {
    return is_apart() || (groups.size() > 1 && has_limit()) ||
           std::any_of(groups.begin(), groups.end(),
                       [](const Group& g) { return g.is_cut || g.points > 1; });
  }
};
// A contact that lands. slip: its tangential impulse divided by its normal impulse.
struct LandedRow {
  int32_t shape0 = -1, shape1 = -1, point = -1;
  size_t event = 0, group = 0;
  Vec3f slip{};
};
struct ContactEvents {
  std::vector<ContactEvent> events;
  std::vector<int32_t> hits;  // contact rows, ascending
  std::vector<char> touched;  // {trees}: 1 if contacts push the tree; empty: none
  std::vector<int32_t> root;  // {trees}: the first tree of its island; empty: each tree is isolated
  std::vector<int32_t> limits;  // dofs whose limits hit
  std::vector<LandedRow> landed;
  // Events and groups that landed in the step before and whose friction has changed: it slides in
  // another direction, or has just begun to slide.
  std::vector<std::pair<size_t, size_t>> turned;
};

}  // namespace novaphy
