// Kernels of a step of articulations with contacts and dry friction (articulation/islands.h). A
// group has the articulations of one world, which may touch each other.
//
// Kernels if each group is one tree:
//
//   articulation_contact_group    the group of each contact, for the lists of contacts by group
//   articulation_contact_step     a team of threads per group: the whole step
//
// Kernels if groups have several trees, or if TreeSteps solves some trees:
//
//   articulation_contact_open     a row per tree: the link frames; without `lanes` also `start`
//   articulation_contact_islands  a row per group: its islands, and their contacts
//   articulation_contact_start    a row per tree: its rates without impulses
//   articulation_contact_solve    a row per tree: the island whose root the tree is
//   articulation_contact_finish   a row per tree: its new state
//   articulation_contact_notes    a row per group: the active branches of its islands
//
// Kernels after the step in both cases:
//
//   articulation_contact_keep     the impulses for the warm start of the next step
//   articulation_note_some, articulation_note_step   the active branches of a step (active_rows.h)
//
//   articulation_contact_copy     copies the contacts of a step for its adjoint
#pragma once

// clang-format off: before what reads it
#include "novaphy/dynamics/articulation/matrix_trees.h"
// clang-format on
#include "novaphy/core/row_kernel.h"
#include "novaphy/dynamics/articulation/group_notes.h"

namespace novaphy {

// Arguments. group: result per contact; -1: the contact moves nothing. force, impulses: null: not
// requested.
struct ArticulationContactGroupArguments {
  NOVAPHY_ARGUMENTS(Part<ContactShapes> shapes; Given<ArticulationRows> rows; Given<int32_t> count;
                    WritesRow<int32_t> group; Optional<Writes<Vec3f>> force;
                    Optional<Changed<Vec3f>> impulses;)
};
NOVAPHY_ROW_KERNEL(articulation_contact_group, ArticulationContactGroupArguments) {
  a.group[row] = -1;
  // After an overflow the last rows may be empty (core/sim/contact_count.h).
  if (row >= *a.count || (*a.count > n && a.shapes.at.shape0[row] < 0)) return;
  if (a.force != nullptr) a.force[row] = Vec3f{};
  if (a.impulses != nullptr) a.impulses[row] = Vec3f{};
  articulation::ContactSide sides[2];
  int32_t widths[2];
  const bool there = contact_sides(a.shapes, static_cast<int32_t>(row), sides);
  const ArticulationRows* const rows = a.rows;
  const bool moves = articulation::set_widths(rows, sides, widths);
  if (moves)
    a.group[row] = a.shapes.group_of_tree[articulation::moved_tree(rows, sides)];
  else if (!there)
    a.group[row] = 0;  // group 0 then reports the shape that does not exist
}

NOVAPHY_ROW_KERNEL(articulation_contact_step, ArticulationContactStepArguments) {
  const Team team(row);
  if (!team.works()) return;
  const GroupStep s(a, row / kTeamThreads);
  const int32_t tree = a.of.trees[s.first_tree()];
  if (team.rank == 0) {
    open_and_start(s, tree);
    find_islands(s);
  }
  team.wait();
  solve_island(team, s, tree);
  team.wait();
  if (team.rank > 0) return;
  finish_tree(s, tree);
  if (a.notes != nullptr) note_group(s);
}

inline GroupStep group_of_tree(const ArticulationContactStepArguments& a, int64_t tree) {
  return {a, a.of.shapes.group_of_tree[tree]};
}
NOVAPHY_ROW_KERNEL(articulation_contact_open, ArticulationContactStepArguments) {
  const GroupStep s = group_of_tree(a, row);
  if (a.lanes.value != 0)
    open_tree(s, static_cast<int32_t>(row));
  else
    open_and_start(s, static_cast<int32_t>(row));
}
NOVAPHY_ROW_KERNEL(articulation_contact_islands, ArticulationContactStepArguments) {
  find_islands({a, row});
}
NOVAPHY_ROW_KERNEL(articulation_contact_start, ArticulationContactStepArguments) {
  if (a.of.nodes[row].taken == 0 && a.step.status[row] == 0)
    start_tree(group_of_tree(a, row), static_cast<int32_t>(row));
}
NOVAPHY_ROW_KERNEL(articulation_contact_solve, ArticulationContactStepArguments) {
  const IslandNode& node = a.of.nodes[row];
  if (node.root == row && node.taken == 0 && node.solved == 0)
    solve_island(Alone{}, group_of_tree(a, row), static_cast<int32_t>(row));
}
NOVAPHY_ROW_KERNEL(articulation_contact_finish, ArticulationContactStepArguments) {
  if (a.of.nodes[row].taken == 0) finish_tree(group_of_tree(a, row), static_cast<int32_t>(row));
}
NOVAPHY_ROW_KERNEL(articulation_contact_notes, ArticulationContactStepArguments) {
  note_group({a, row});
}

struct ArticulationContactKeepArguments {
  NOVAPHY_ARGUMENTS(Given<int32_t> begin; Given<articulation::KeptContact> now;
                    Given<float> now_friction; Writes<int32_t> kept_begin;
                    Changed<articulation::KeptContact> kept; Changed<float> kept_friction;
                    Writes<float> kept_dt; Number<float> dt; Number<int64_t> groups, dofs;)
};
NOVAPHY_ROW_KERNEL(articulation_contact_keep, ArticulationContactKeepArguments) {
  if (row == 0) *a.kept_dt = a.dt.value;
  if (row <= a.groups.value) a.kept_begin[row] = a.begin[row];
  if (row < a.dofs.value) a.kept_friction[row] = a.now_friction[row];
  if (row < a.begin[a.groups.value]) a.kept[row] = a.now[row];
}

// Arguments of the copy of a step's contacts for its adjoint. A later search overwrites the
// original arrays.
struct ArticulationContactCopyArguments {
  NOVAPHY_ARGUMENTS(Given<int32_t> count; Part<ContactPlaces> from; Changed<int32_t> to_count;
                    Changed<int32_t> shape0, shape1; Changed<Vec3f> point0, point1, normal;
                    Changed<float> margin0, margin1; Number<int64_t> most;)
};
NOVAPHY_ROW_KERNEL(articulation_contact_copy, ArticulationContactCopyArguments) {
  int32_t count = *a.count < 0 ? 0 : *a.count;
  if (count > a.most.value) count = static_cast<int32_t>(a.most.value);
  if (row == 0) *a.to_count = count;
  if (row >= count) return;
  a.shape0[row] = a.from.shape0[row];
  a.shape1[row] = a.from.shape1[row];
  a.point0[row] = a.from.point0[row];
  a.point1[row] = a.from.point1[row];
  a.normal[row] = a.from.normal[row];
  a.margin0[row] = a.from.margin0[row];
  a.margin1[row] = a.from.margin1[row];
}

// Arguments of the sum of the groups' branches: the first kernel sums them in parts, the second
// kernel sums the parts. The states of the contacts (`seen`) are kept for the next step.
struct ArticulationNoteArguments {
  NOVAPHY_ARGUMENTS(Given<articulation::BranchNotes> notes;
                    WritesRow<articulation::BranchNotes> some; Given<SeenContact> seen;
                    Given<int32_t> begin; Changed<SeenContact> seen_before;
                    Writes<int32_t> seen_begin; Number<int64_t> groups;)
};
NOVAPHY_ROW_KERNEL(articulation_note_some, ArticulationNoteArguments) {
  articulation::BranchNotes sum;
  for (int64_t g = row; g < a.groups.value; g += n) articulation::note_all(a.notes[g], sum);
  a.some[row] = sum;
  for (int64_t g = row; g <= a.groups.value; g += n) a.seen_begin[g] = a.begin[g];
  for (int64_t k = row; k < a.begin[a.groups.value]; k += n) a.seen_before[k] = a.seen[k];
}
struct ArticulationNoteStepArguments {
  NOVAPHY_ARGUMENTS(Given<articulation::BranchNotes> some; Changed<ContactBranches> branches;
                    Number<int64_t> count;)
};
NOVAPHY_ROW_KERNEL(articulation_note_step, ArticulationNoteStepArguments) {
  articulation::BranchNotes sum;
  for (int64_t k = 0; k < a.count; ++k) articulation::note_all(a.some[k], sum);
  articulation::note_step(sum, *a.branches);
}

}  // namespace novaphy
