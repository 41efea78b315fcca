// The contacts of a group that push, stick or slide in a step, for articulation_contact_kernels.h.
#pragma once

#include "novaphy/dynamics/articulation/active_rows.h"
#include "novaphy/dynamics/articulation/group_step.h"
#include "novaphy/dynamics/articulation/open_friction.h"

namespace novaphy {

inline void note_island(const GroupStep& s, int32_t root, articulation::BranchNotes& notes) {
  const IslandNode& node = s.a.nodes[root];
  if (node.failed != 0) notes.all.jumps |= kLawJumps;
  if (node.failed != 0 || node.coupled == 0) return;
  const articulation::IslandContact* const rows = rows_of(s, root);
  for (int32_t n = 0; n < node.rows; ++n) {
    articulation::note_contact(s.contacts, s.law, s.all.by_restitution.value != 0, rows[n], notes);
    s.all.seen[s.places(root)[n]] = articulation::seen_contact(s.contacts, rows[n], s.law.cone);
  }
  if (articulation::has_open_friction(rows, node.rows, s.law.cone)) notes.all.jumps |= kOpenFriction;
  for_friction(s, root, [&](const articulation::PgsJointFriction<float>& f, int32_t) {
    articulation::note_friction(f, notes);
  });
  const articulation::IslandResult& of = node.result;
  if (articulation::far_from_converged(of.residual, of.largest, s.all.tolerance.value))
    notes.far = 1;
  articulation::raise(notes.all.residual, articulation::relative_residual(of.residual, of.largest,
                                                                          s.all.tolerance.value));
}
inline void note_group(const GroupStep& s) {
  articulation::BranchNotes notes;
  const int32_t* const trees = s.a.trees;
  for (int32_t k = s.first_tree(); k < s.end_tree(); ++k)
    if (s.root(trees[k]) == trees[k]) note_island(s, trees[k], notes);
  if (s.all.continues.value != 0) {
    const int32_t begin = s.all.seen_begin[s.group];
    note_events(s.all.seen_before + begin, s.all.seen_begin[s.group + 1] - begin,
                s.all.seen + s.first_place(), s.end_place() - s.first_place(), notes.all);
  }
  s.all.notes[s.group] = notes;
}

}  // namespace novaphy
