// The search for contacts that begin in a step, for gradients of the motion.
#include <algorithm>
#include <cmath>
#include <utility>

#include "contact_steps.h"

namespace novaphy {
namespace {

namespace art = articulation;
constexpr float kLeastApproach = 1e-3f;  // m/s
constexpr float kParallel = 0.999f;
constexpr float kAtCone = 0.999f;  // above this fraction of the cone, friction slides
constexpr float kTurned = 0.02f;   // change of direction, relative to the coefficient of friction

// Returns whether two contacts have the same delay: the same links and the same normal.
bool hit_together(const art::ContactRows& c, const art::IslandContact& a,
                  const art::IslandContact& b) {
  for (int side = 0; side < 2; ++side)
    if (a.sides[side].tree != b.sides[side].tree ||
        (a.sides[side].tree >= 0 && a.sides[side].link != b.sides[side].link))
      return false;
  return math::dot(c.normal[a.contact], c.normal[b.contact]) > kParallel;
}

// Returns the velocities along the normals of an island without its impulses. The function removes
// the impulses and adds them again, which changes bits. Call this only after the step has written
// its results.
std::vector<float> free_slips(const GroupStep& s, int32_t root) {
  const IslandNode& node = s.a.nodes[root];
  art::IslandContact* const rows = rows_of(s, root);
  const auto push = [&](float sign) {
    for (int32_t n = 0; n < node.rows; ++n)
      for (int32_t r = 0; r < 3; ++r)
        art::push(rows[n].solver, r, sign * rows[n].solver.impulse[r]);
    for_friction(s, root, [&](const art::PgsJointFriction<float>& f, int32_t) {
      for (int32_t k = 0; k < f.width; ++k) f.rates[k] += sign * f.impulse * f.response[k];
    });
  };
  push(-1.0f);
  std::vector<float> slips;
  for (int32_t n = 0; n < node.rows; ++n) slips.push_back(art::slip(rows[n].solver, 0));
  push(1.0f);
  return slips;
}

template <class F>
void for_rows(const GroupStep& s, int32_t root, const F& f) {
  for (int32_t n = 0; n < s.a.nodes[root].rows; ++n) f(rows_of(s, root)[n], n);
}

// Returns which rows of an island hit. `continues`: the step before is known. Some approaching rows
// do not push, because other rows stop them (corners of a face). The smooth motion excludes these
// rows too.
std::vector<char> find_hits(const GroupStep& s, int32_t root, bool continues,
                            ContactEvents& found) {
  const SeenContact* const seen = s.all.seen_before + s.all.seen_begin[s.group];
  const int32_t before = continues ? s.all.seen_begin[s.group + 1] - s.all.seen_begin[s.group] : 0;
  const std::vector<float> slips = free_slips(s, root);
  std::vector<char> hits(slips.size());
  std::vector<int32_t> spared;
  int32_t next = 0;
  for_rows(s, root, [&](const art::IslandContact& row, int32_t n) {
    const SeenContact now = art::seen_contact(s.contacts, row, s.law.cone);
    const bool pushed = mode_of(seen, before, next, now) != 0;
    const bool pushes = row.solver.impulse[0] > 0.0f;
    for (const art::ContactSide& side : row.sides)
      if (pushes && side.tree >= 0) found.touched[static_cast<size_t>(side.tree)] = 1;
    const float free = slips[static_cast<size_t>(n)];
    const float rest = std::max(kLeastApproach, std::abs(free - row.before));
    if (!(row.before < -rest && (row.target.bounce > 0.0f || !pushed))) return;
    hits[static_cast<size_t>(n)] = pushes ? 1 : 0;
    (pushes ? found.hits : spared).push_back(row.contact);
  });
  if (std::find(hits.begin(), hits.end(), 1) != hits.end())
    found.hits.insert(found.hits.end(), spared.begin(), spared.end());
  return hits;
}

bool slides(const art::PgsContact<float>& c) {
  return std::hypot(c.impulse[1], c.impulse[2]) >= kAtCone * c.friction * c.impulse[0];
}
// Returns the tangential impulse divided by the normal impulse, in the world frame.
Vec3f slip_of(const art::IslandContact& row) {
  const float* const impulse = row.solver.impulse;
  return (row.frame.axes[1] * impulse[1] + row.frame.axes[2] * impulse[2]) * (1.0f / impulse[0]);
}
LandedRow landed_row(const art::ContactRows& c, const art::IslandContact& row) {
  const int32_t i = row.contact;
  return {.shape0 = c.shape0[i],
          .shape1 = c.shape1[i],
          .point = c.point_id == nullptr ? -1 : c.point_id[i],
          .slip = slip_of(row)};
}

// Adds the groups of an island's rows that hit to the event. `begin`: the first dof of each tree
// within the event. `number`: the index of the event.
void add_groups(const GroupStep& s, int32_t root, const std::vector<char>& hits,
                const std::vector<int32_t>& begin, size_t dofs, size_t number, ContactEvent& event,
                std::vector<LandedRow>& landed) {
  std::vector<const art::IslandContact*> firsts;  // the first row of each group
  for_rows(s, root, [&](const art::IslandContact& row, int32_t n) {
    if (hits[static_cast<size_t>(n)] == 0) return;
    const auto at = std::find_if(
        firsts.begin(), firsts.end(),
        [&](const art::IslandContact* first) { return hit_together(s.contacts, *first, row); });
    const auto group = static_cast<size_t>(at - firsts.begin());
    if (at == firsts.end()) {
      firsts.push_back(&row);
      event.groups.emplace_back();
      event.groups.back().normal_push.resize(dofs);
      event.groups.back().push.resize(dofs);
      event.groups.back().shape0 = s.contacts.shape0[row.contact];
      event.groups.back().shape1 = s.contacts.shape1[row.contact];
    }
    ContactEvent::Group& to = event.groups[group];
    for (int side = 0; side < 2; ++side) {
      const art::RowSide<float>& of = row.solver.sides[side];
      const int32_t tree = row.sides[side].tree;
      if (of.width == 0 || tree < 0) continue;
      const auto first = static_cast<size_t>(begin[static_cast<size_t>(tree)]);
      for (int32_t k = 0; k < s.rows(tree).dof_count; ++k) {
        to.normal_push[first + static_cast<size_t>(k)] += of.jacobian[k] * row.solver.impulse[0];
        for (int r = 0; of.response != nullptr && r < 3; ++r)
          to.push[first + static_cast<size_t>(k)] -=
              of.response[r * of.width + k] * row.solver.impulse[r];
      }
    }
    ++to.points;
    to.impulse += row.solver.impulse[0];
    to.gap += row.solver.impulse[0] * row.place.gap;
    if (row.solver.friction > 0.0f && to.friction != MotionFriction::Slides)
      to.friction = slides(row.solver) ? MotionFriction::Slides : MotionFriction::Sticks;
    if (!(row.place.gap > 0.0f) || row.target.bounce > 0.0f) return;
    event.lands = to.lands = true;
    LandedRow& in = landed.emplace_back(landed_row(s.contacts, row));
    in.event = number;
    in.group = group;
  });
}

void find_turned(const GroupStep& s, int32_t root, std::span<const LandedRow> landed,
                 std::vector<std::pair<size_t, size_t>>& turned) {
  if (landed.empty()) return;
  for_rows(s, root, [&](const art::IslandContact& row, int32_t) {
    if (!(row.solver.impulse[0] > 0.0f) || !slides(row.solver)) return;
    const LandedRow now = landed_row(s.contacts, row);
    for (const LandedRow& of : landed) {
      if (of.shape0 != now.shape0 || of.shape1 != now.shape1 || of.point != now.point) continue;
      if (math::length(now.slip - of.slip) > kTurned * row.solver.friction)
        turned.emplace_back(of.event, of.group);
    }
  });
}

}  // namespace

ContactEvents ContactSteps::events(const float* qd, bool continues,
                                   std::span<const LandedRow> landed) const {
  ContactEvents found;
  const auto count = static_cast<size_t>(articulations_.count());
  found.touched.resize(count);
  found.root.resize(count);
  bool any = false;
  for (int64_t group = 0; group < groups_; ++group) {
    const GroupStep s(*last_, group);
    for (int32_t t = s.first_tree(); t < s.end_tree(); ++t) {
      const int32_t root = s.a.trees[t];
      found.root[static_cast<size_t>(root)] = s.root(root);
      if (s.root(root) != root || s.a.nodes[root].coupled == 0) continue;
      any = true;
      const std::vector<char> hits = find_hits(s, root, continues, found);
      find_turned(s, root, landed, found.turned);
      ContactEvent event;
      std::vector<int32_t> begin(count, -1);
      int32_t dofs = 0;
      const auto add_tree = [&](int32_t i) {
        begin[static_cast<size_t>(i)] = dofs;
        dofs += s.rows(i).dof_count;
        event.trees.push_back(i);
      };
      for (int32_t i = root; i >= 0; i = s.a.nodes[i].next) add_tree(i);
      // Kinematic trees belong to no island, but the time of a hit depends on their motion.
      for_rows(s, root, [&](const art::IslandContact& row, int32_t n) {
        for (int side = 0; hits[static_cast<size_t>(n)] != 0 && side < 2; ++side) {
          const int32_t i = row.sides[side].tree;
          if (row.solver.sides[side].width != 0 && begin[static_cast<size_t>(i)] < 0) add_tree(i);
        }
      });
      add_groups(s, root, hits, begin, static_cast<size_t>(dofs), found.events.size(), event,
                 found.landed);
      for (ContactEvent::Group& of : event.groups) {
        float speed = 0.0f;
        for (const int32_t tree : event.trees)
          for (int32_t k = 0; k < s.rows(tree).dof_count; ++k)
            speed += of.normal_push[static_cast<size_t>(begin[static_cast<size_t>(tree)] + k)] *
                     qd[s.rows(tree).first_dof + k];
        of.approach = std::abs(speed);
      }
      if (!event.groups.empty()) found.events.push_back(std::move(event));
    }
  }
  std::sort(found.hits.begin(), found.hits.end());
  if (!any) {
    found.touched.clear();
    found.root.clear();
  }
  return found;
}

}  // namespace novaphy
