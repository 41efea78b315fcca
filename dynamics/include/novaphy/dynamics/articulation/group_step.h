// The step of a group of trees with contacts, for the kernels of articulation_contact_kernels.h.
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/dynamics/articulation/contact_groups.h"
#include "novaphy/dynamics/articulation/island_sweeps.h"

namespace novaphy {

// Arguments of a step with contacts. A group is the set of trees of a world. A place is an index
// into a group's list of contacts.
//   step.status     per tree. If contact c links the tree to another group, -1 - c, an error
//   moved_by        per link: a bit for each dof that moves the link
//   most_isolated   largest number of contacts of an island that tree_contacts.h solves
//   kept, now       warm start: the contact impulses of the step before (from kept_begin on), and
//                   those of this step by place
//   kept_friction, now_friction: the same for the impulses of dry friction {dofs}
//   lanes           1: SIMD lanes of the CPU have solved the trees marked `taken`
//   continues       1: the step starts in the state in which the step before ended
// Only for derivatives, else null: impulses along n, t1 and t2, friction_impulses, notes (active
// sets), and `seen` (geometry by place) with that of the step before.
struct ArticulationContactStepArguments {
  NOVAPHY_ARGUMENTS(Part<ArticulationStepArguments> step; Part<ContactGroupArguments> of;
                    Optional<Given<int32_t>> point_id; Given<int32_t> moved_by;
                    Number<float> tolerance; Number<int64_t> most_sweeps, warm_start, most_isolated;
                    Given<int32_t> kept_begin; Given<articulation::KeptContact> kept;
                    Given<float> kept_dt, kept_friction; Changed<float> now_friction;
                    Writes<articulation::KeptContact> now; Writes<int32_t> places;
                    Optional<Writes<Vec3f>> force; Optional<Changed<Vec3f>> impulses;
                    Optional<Changed<float>> friction_impulses;
                    Optional<Writes<articulation::BranchNotes>> notes;
                    Optional<Writes<SeenContact>> seen; Optional<Given<SeenContact>> seen_before;
                    Optional<Given<int32_t>> seen_begin;
                    Number<int64_t> by_restitution, continues, lanes;)
};

// Returns the memory of a contact of trees with `dofs` dofs, enough for any method of solution.
inline int64_t island_contact_bytes(int32_t dofs) {
  namespace art = articulation;
  const int64_t coupled =
      static_cast<int64_t>(sizeof(art::IslandContact)) + contact_row_bytes(dofs);
  // A of n <= kCoupledContacts contacts has 9 n^2 entries, at most 9 kCoupledContacts per contact.
  const int64_t coupling = art::kCoupledContacts * 9 * static_cast<int64_t>(sizeof(float));
  const int64_t isolated =
      static_cast<int64_t>(sizeof(art::TreeContact<float>) + sizeof(art::TreeContactLink<float>)) +
      art::tree_contact_bytes<float>(1, dofs) + coupling;
  return ((coupled > isolated ? coupled : isolated) + 7) / 8 * 8;
}

// The memory (bytes) of a group whose only tree fits there, followed by its contacts if they fit.
inline constexpr int64_t kIslandMemory = 12288;

// The step of a group with contacts. A stride of 0: each group has kIslandMemory.
struct GroupStep : ContactGroup {
  const ArticulationContactStepArguments& all;
  const float warm_scale;

  GroupStep(const ArticulationContactStepArguments& arguments, int64_t row)
      : ContactGroup(arguments.step.in, arguments.of,
                     arguments.step.workspace + (arguments.step.stride.value > 0 ? 0 : row) *
                                                    (kIslandMemory / int64_t{sizeof(float)}),
                     arguments.step.stride.value, row, arguments.point_id),
        all(arguments),
        warm_scale(scale_of(arguments)) {}

  static float scale_of(const ArticulationContactStepArguments& a) {
    const float before = a.warm_start.value != 0 ? *a.kept_dt : 0.0f;
    return before > 0.0f ? a.step.in.dt.value / before : 1.0f;
  }
  // Returns the memory of an island's contacts.
  unsigned char* rows_memory(int32_t root) const {
    return island_memory() + a.nodes[root].begin * a.contact_stride.value * int64_t{sizeof(float)};
  }
  // Returns the places of an island's contacts, in their order.
  const int32_t* places(int32_t root) const {
    return all.places + (first_place() + a.nodes[root].begin);
  }
  bool is_kept(int32_t place) const { return a.chain[place].kept >= 0; }
  // Returns the impulses of the step before, or zeros. (GPUs have read through a null pointer.)
  articulation::KeptContact kept(int32_t place) const {
    articulation::KeptContact of{};
    if (is_kept(place)) of = all.kept[a.chain[place].kept];
    return of;
  }
};

// Computes the frames and motions of a tree's links, and makes the tree an island of its own.
inline void open_tree(const GroupStep& s, int32_t i) {
  articulation::IslandTree of = s.tree(i);
  articulation::link_frames(of.tree, s.in.q, of.ws);
  articulation::link_motions(of.tree, of.qd, of.ws);
  s.all.step.status[i] = 0;
  start_node(s, i);
}
// Computes the rates of a tree after the step without contact impulses.
inline void start_tree(const GroupStep& s, int32_t i) {
  articulation::IslandTree of = s.tree(i);
  const ArticulationRows& rows = s.rows(i);
  const int32_t failed = articulation::accelerate(of.tree, s.in, s.how, false, of.ws);
  if (failed >= 0) s.all.step.status[i] = 1 + failed + rows.first_dof;
  if (failed < 0) articulation::free_rates(of.tree, s.in, s.how, of.ws);
  for (int32_t k = 0; k < 2 * articulation::padded_dofs(rows.dof_count); ++k)
    of.rates[k] = failed < 0 && k < rows.dof_count ? of.ws.qd_next[k] : 0.0f;
}
inline void open_and_start(const GroupStep& s, int32_t i) {
  s.all.step.status[i] = 0;
  start_tree(s, i);
  start_node(s, i);
}

// Returns whether a contact may touch in the step, or a tree of it failed or is in another group.
inline bool is_near(const GroupStep& s, int32_t contact) {
  articulation::ContactSide sides[2];
  if (!contact_sides(s.a.shapes, contact, sides)) return true;
  for (const articulation::ContactSide& side : sides) {
    if (side.tree < 0) continue;
    if (s.a.shapes.group_of_tree[side.tree] != s.group || s.all.step.status[side.tree] != 0)
      return true;
  }
  const auto tree_of = [&](int32_t i) { return s.tree(i); };
  return articulation::may_touch(s.contacts, contact, sides, tree_of, s.how.dt);
}

// Joins the trees of a contact that may touch. A contact with another group makes a tree fail.
inline void join_step_contact(const GroupStep& s, int32_t place) {
  const int32_t contact = s.a.contacts[place];
  if (is_near(s, contact)) {
    const int32_t fails = join_contact(s, place);
    if (fails >= 0) s.all.step.status[fails] = -1 - contact;
  } else {
    s.a.chain[place] = {-2, -1};
  }
  articulation::KeptContact& now = s.all.now[place];
  now = articulation::KeptContact{};
  now.shape0 = s.a.shapes.at.shape0[contact];
  now.shape1 = s.a.shapes.at.shape1[contact];
  if (s.all.seen != nullptr) s.all.seen[place] = {now.shape0, now.shape1, -1, 0};
}

inline void list_step_contact(const GroupStep& s, int32_t place, int32_t& next_kept) {
  if (list_contact(s, place) < 0 || s.all.warm_start.value == 0) return;
  const int32_t begin = s.all.kept_begin[s.group];
  const int32_t kept =
      articulation::find_kept(s.all.kept + begin, s.all.kept_begin[s.group + 1] - begin, next_kept,
                              s.contacts, s.a.contacts[place]);
  s.a.chain[place].kept = kept < 0 ? -1 : begin + kept;
}

// Orders the contacts of an island in the list, behind the `used` contacts of earlier islands.
inline void close_island(const GroupStep& s, int32_t root, int32_t& used) {
  IslandNode& node = s.a.nodes[root];
  node.begin = used;
  used += node.rows;
  int32_t* to = s.all.places + (s.first_place() + node.begin);
  for (int32_t place = node.first_row; place >= 0; place = s.a.chain[place].next) *to++ = place;
  bool friction = false;
  for (int32_t i = root; i >= 0; i = s.a.nodes[i].next)
    for (int32_t k = 0; k < s.rows(i).dof_count; ++k) friction = friction || s.has_friction(i, k);
  if (friction || node.rows > s.all.most_isolated.value) node.coupled = 1;
}

// Finds the islands; call this after open_tree or start_tree of all trees.
inline void find_islands(const GroupStep& s) {
  const int32_t* const trees = s.a.trees;
  for (int32_t place = s.first_place(); place < s.end_place(); ++place) join_step_contact(s, place);
  list_trees(s);
  int32_t next_kept = 0, used = 0;
  for (int32_t place = s.first_place(); place < s.end_place(); ++place)
    list_step_contact(s, place, next_kept);
  for (int32_t k = s.first_tree(); k < s.end_tree(); ++k)
    if (s.root(trees[k]) == trees[k]) close_island(s, trees[k], used);
}

inline void take_contact(const GroupStep& s, int32_t place,
                         const articulation::ContactFrame<float>& frame, const float* impulse) {
  const int32_t contact = s.a.contacts[place];
  const articulation::KeptContact& now = s.all.now[place] =
      articulation::kept_contact(s.contacts, contact, frame, impulse);
  if (s.all.force != nullptr)
    s.all.force[contact] = articulation::contact_force(frame, now, s.how.dt);
  if (s.all.impulses != nullptr) s.all.impulses[contact] = {impulse[0], impulse[1], impulse[2]};
}

// Applies the velocity limits of a tree without contacts.
inline void hold_rates(const GroupStep& s, int32_t i) {
  const articulation::IslandTree of = s.tree(i);
  articulation::Workspace<float> ws = of.ws;
  int32_t failed = articulation::hold_rates(of.tree, s.in, s.how, true, ws);
  if (failed < 0) failed = articulation::find_infinite(of.tree, ws);
  if (failed >= 0) s.all.step.status[i] = 1 + failed + s.rows(i).first_dof;
  if (failed < 0) articulation::free_rates(of.tree, s.in, s.how, ws);
}

// Returns the data of a contact between a tree and the world, and the index of its link.
inline articulation::TreeContact<float> contact_of_tree(const GroupStep& s, int32_t tree,
                                                        int32_t place, int32_t& link) {
  const int32_t contact = s.a.contacts[place];
  articulation::ContactSide sides[2];
  contact_sides(s.a.shapes, contact, sides);
  const int32_t side = sides[0].tree >= 0 ? 0 : 1;
  link = sides[side].link;
  return articulation::tree_contact(s.contacts, contact, side,
                                    s.all.moved_by[s.rows(tree).first_link + link],
                                    s.material(contact), s.kept(place), s.warm_scale);
}

// Solves an isolated island: one tree that touches only the world. The threads of a team share the
// contacts. The first thread changes the tree.
template <class Team>
articulation::IslandResult solve_isolated(const Team& team, const GroupStep& s, int32_t root) {
  IslandNode& node = s.a.nodes[root];
  const articulation::IslandTree of = s.tree(root);
  const int32_t dofs = of.tree.dof_count;
  const int64_t used = tree_rates_offset(of.tree.link_count, dofs) + tree_rates_bytes(dofs);
  const int64_t bytes =
      node.rows * static_cast<int64_t>(sizeof(articulation::TreeContact<float>) +
                                       sizeof(articulation::TreeContactLink<float>)) +
      articulation::tree_contact_bytes<float>(node.rows, dofs);
  const bool fits = s.stride == 0 && used + bytes <= kIslandMemory;
  auto* const found = reinterpret_cast<articulation::TreeContact<float>*>(
      fits ? s.memory(0) + used : s.rows_memory(root));
  auto* const links = reinterpret_cast<articulation::TreeContactLink<float>*>(found + node.rows);
  auto m = articulation::make_tree_contact_memory<float>(links + node.rows, node.rows, dofs);
  m.shift = of.rates + articulation::padded_dofs(dofs);
  const int32_t* const places = s.places(root);
  for (int32_t n = team.rank; n < node.rows; n += team.size) {
    int32_t link = 0;
    found[n] = contact_of_tree(s, root, places[n], link);
    const articulation::LinkState<float>& at = of.ws.links[link];
    links[n] = {at.q, at.p, at.origin};
  }
  team.wait();
  if (team.rank == 0 && !articulation::touching(found, node.rows)) hold_rates(s, root);
  team.wait();
  articulation::Workspace<float> ws = of.ws;
  articulation::TreeContactResult<float> result;
  int32_t failed = -1;
  for (int32_t round = 0; node.solved == 0; ++round) {
    result = articulation::solve_tree_contacts(
        team, of.tree, ws, s.law, static_cast<int32_t>(s.all.most_sweeps.value),
        s.all.tolerance.value, found, links, node.rows, of.qd, m, ws.qd_next);
    ws.shift = m.shift;
    if (team.rank == 0) {
      failed = articulation::first_not_finite(ws, dofs);
      const bool renewed = failed < 0 && articulation::renew_tree(of.tree, s.in, s.how, found,
                                                                  node.rows, m, round, ws);
      if (renewed) failed = articulation::solve_accelerations(of.tree, s.in, s.how, ws);
      if (renewed && failed < 0) articulation::free_rates(of.tree, s.in, s.how, ws);
      node.solved = !renewed || failed >= 0;
    }
    team.wait();
  }
  if (failed >= 0) s.all.step.status[root] = 1 + failed + s.rows(root).first_dof;
  for (int32_t n = team.rank; n < node.rows; n += team.size)
    take_contact(s, places[n], m.rows[n].frame, m.rows[n].impulse);
  return {static_cast<int32_t>(result.sweeps), result.residual, result.largest};
}

// Calls f(row, dof in the model's arrays) for each dof with dry friction of an island.
template <class F>
void for_friction(const GroupStep& s, int32_t root, const F& f) {
  for (int32_t i = root; i >= 0; i = s.a.nodes[i].next)
    for (int32_t k = 0; k < s.rows(i).dof_count; ++k)
      if (s.has_friction(i, k)) f(s.friction(i)[k], s.rows(i).first_dof + k);
}
// Returns the contact rows of a coupled island.
inline articulation::IslandContact* rows_of(const GroupStep& s, int32_t root) {
  return reinterpret_cast<articulation::IslandContact*>(s.rows_memory(root));
}

// Calls f(row) for the contacts of a coupled island.
template <class F>
void for_rows(const GroupStep& s, int32_t root, bool back, const F& f) {
  const int32_t count = s.a.nodes[root].rows;
  articulation::IslandContact* const rows = rows_of(s, root);
  for (int32_t k = 0; k < count; ++k) f(rows[back ? count - 1 - k : k]);
}
// Completes the data of a contact (island_sweeps.h).
inline void complete_row(const GroupStep& s, articulation::IslandContact& row) {
  articulation::build_responses(
      s.contacts, [&](int32_t i) { return s.tree(i); }, row);
  articulation::set_steps<float>(s.law.dt, row.solver);
}

// Builds the rows of a coupled island, and starts from the impulses of the step before. `all`: also
// completes the data of contacts that may not push.
inline void start_coupled(const GroupStep& s, int32_t root, bool all) {
  const ContactGroupArguments& a = s.a;
  const IslandNode& node = a.nodes[root];
  articulation::IslandContact* const rows = rows_of(s, root);
  const int32_t* const places = s.places(root);
  auto* numbers = reinterpret_cast<float*>(rows + node.rows);
  for (int32_t n = 0; n < node.rows; ++n) {
    articulation::IslandContact& row = rows[n];
    row = articulation::IslandContact{};
    place_row(s, a.contacts[places[n]], numbers, row);
    articulation::build_jacobian(
        s.contacts, [&](int32_t i) { return s.tree(i); }, row);
    articulation::aim(s.law, s.material(row.contact), row);
    if (all || s.is_kept(places[n]) || s.all.notes != nullptr) complete_row(s, row);
  }
  for (int32_t i = root; i >= 0; i = a.nodes[i].next) build_dry(s, i);
  for (int32_t n = 0; n < node.rows; ++n)
    if (s.is_kept(places[n]))
      articulation::start_from_kept(s.kept(places[n]), s.warm_scale, s.law.cone, rows[n]);
  for_friction(s, root, [&](articulation::PgsJointFriction<float>& f, int32_t row) {
    if (s.all.warm_start.value != 0)
      articulation::warm_start(f, s.warm_scale * s.all.kept_friction[row]);
  });
}

// Solves any island. `swept`: the result of sweep_rates after start_coupled; null: not called yet.
inline articulation::IslandResult solve_coupled(const GroupStep& s, int32_t root,
                                                const articulation::IslandResult* swept) {
  const ContactGroupArguments& a = s.a;
  const IslandNode& node = a.nodes[root];
  articulation::IslandContact* const rows = rows_of(s, root);
  const auto contacts = [&](bool back, const auto& f) { for_rows(s, root, back, f); };
  const auto complete = [&](articulation::IslandContact& row) { complete_row(s, row); };
  const auto friction = [&](const auto& f) {
    for_friction(s, root, [&](articulation::PgsJointFriction<float>& dry, int32_t) { f(dry); });
  };
  articulation::IslandResult result;
  bool renewed = true;
  for (int32_t round = 0; renewed; ++round) {
    if (round == 0 && swept != nullptr) {
      result = *swept;
    } else {
      start_coupled(s, root, false);
      result = articulation::sweep_rates(s.law.cone, static_cast<int32_t>(s.all.most_sweeps.value),
                                         s.all.tolerance.value, contacts, friction, complete);
    }
    articulation::finish_sweeps(contacts, friction, complete, result);
    renewed = false;
    for (int32_t i = root; i >= 0; i = a.nodes[i].next)
      renewed =
          articulation::renew_tree(s.tree(i), s.in, s.how, round, contacts, friction) || renewed;
    for (int32_t i = root; renewed && i >= 0; i = a.nodes[i].next) {
      const int32_t failed = articulation::restart_tree(s.tree(i), s.in, s.how);
      if (failed < 0) continue;
      renewed = false;
      for (int32_t k = root; k >= 0; k = a.nodes[k].next)
        s.all.step.status[k] = 1 + failed + s.rows(i).first_dof;
    }
  }
  for (int32_t n = 0; n < node.rows; ++n)
    take_contact(s, s.places(root)[n], rows[n].frame, rows[n].solver.impulse);
  for_friction(s, root, [&](const articulation::PgsJointFriction<float>& f, int32_t row) {
    if (s.all.friction_impulses != nullptr) s.all.friction_impulses[row] = f.impulse;
    s.all.now_friction[row] = f.impulse;
  });
  return result;
}

// Solves an island. If a tree fails, the whole island fails. `swept`: as in solve_coupled. The
// threads of a team share isolated islands.
template <class Team>
void solve_island(const Team& team, const GroupStep& s, int32_t root,
                  const articulation::IslandResult* swept = nullptr) {
  const ContactGroupArguments& a = s.a;
  int32_t* const all_status = s.all.step.status;
  IslandNode& node = a.nodes[root];
  int32_t status = 0;
  for (int32_t i = root; i >= 0 && status == 0; i = a.nodes[i].next) status = all_status[i];
  team.wait();
  if (status == 0 && node.coupled == 0 && node.rows > 0) {
    const articulation::IslandResult result = solve_isolated(team, s, root);
    if (team.rank == 0) node.result = result;
  } else if (team.rank > 0) {
    return;
  } else if (status != 0) {
    const float nan = math::bits_float(0x7fc00000);
    for (int32_t i = root; i >= 0; i = a.nodes[i].next) all_status[i] = status;
    for (int32_t n = 0; n < node.rows && s.all.force != nullptr; ++n)
      s.all.force[a.contacts[s.places(root)[n]]] = Vec3f{nan, nan, nan};
    node.failed = 1;
  } else if (node.coupled != 0) {
    node.result = solve_coupled(s, root, swept);
    for (int32_t n = 0; s.all.notes != nullptr && n < node.rows; ++n)
      rows_of(s, root)[n].turns = s.turns(rows_of(s, root)[n]);
  } else {
    for (int32_t i = root; i >= 0; i = a.nodes[i].next) hold_rates(s, i);
  }
}

inline void finish_tree(const GroupStep& s, int32_t i) {
  articulation::IslandTree of = s.tree(i);
  const ArticulationRows& rows = s.rows(i);
  int32_t& status = s.all.step.status[i];
  if (status == 0 && s.a.nodes[s.root(i)].coupled != 0) {
    const int32_t failed =
        articulation::take_rates(of.rates, of.qd, s.how.dt, rows.dof_count, of.ws);
    if (failed >= 0) status = 1 + failed + rows.first_dof;
  }
  if (status != 0) return write_failure(s.all.step, rows);
  of.ws.shift = of.rates + articulation::padded_dofs(rows.dof_count);
  write_step(s.all.step, rows, of.tree, s.in, s.how, of.ws);
}

}  // namespace novaphy
