// The PGS sweeps of an island (islands.h): sweeps of rates, then sweeps of shifts (position
// corrections, pgs.h).
//
// A contact that does not push needs neither Y nor the divisors of a sweep. Both are computed when
// a sweep finds that the contact is about to push. The bits of the impulses do not depend on this.
#pragma once

#include "novaphy/dynamics/articulation/islands.h"
#include "novaphy/dynamics/articulation/rubbing.h"

namespace novaphy::articulation {

// Sweeps shifts. for_rows(f) calls f for each contact. whole(row, speed) returns whether a contact
// that separates at `speed` pushes, and if so completes its data.
template <class ForRows, class Whole>
void sweep_shifts(const ForRows& for_rows, const Whole& whole) {
  bool overlap = false;
  for_rows(
      [&](const IslandContact& row) { overlap = overlap || row.solver.shift < row.solver.bias; });
  float moved = kShiftTolerance;
  for (int32_t k = 0; overlap && k < kShiftSweeps && !(moved < kShiftTolerance); ++k) {
    moved = 0.0f;
    for_rows([&](IslandContact& row) {
      PgsContact<float>& c = row.solver;
      if (!row.whole && !whole(row, moving_slip(c) + c.shift)) return;
      const float by = sweep_shift(c);
      moved = moved < by ? by : moved;
    });
  }
}

// Returns sweep_shifts' `whole` for a function that completes the data of a contact.
template <class Complete>
auto completes_pushing(const Complete& complete) {
  return [&complete](IslandContact& row, float speed) {
    if (!(speed < 0.0f)) return false;
    complete(row);
    return true;
  };
}

// Sweeps over the rates of an island, with the contacts and the dry friction of its joints.
// for_contacts(back, f) calls f for each contact, and for_friction(f) for each joint with dry
// friction. complete(row) completes the data of a contact.
template <class ForContacts, class ForFriction, class Complete>
IslandResult sweep_rates(bool cone, int32_t most_sweeps, float tolerance,
                         const ForContacts& for_contacts, const ForFriction& for_friction,
                         const Complete& complete) {
  IslandResult result;
  const auto whole = completes_pushing(complete);
  do {
    float worst = 0.0f;
    const auto note = [&](float moved) { worst = worst < moved ? moved : worst; };
    for_contacts(result.sweeps % 2 != 0, [&](IslandContact& row) {
      PgsContact<float>& c = row.solver;
      if (row.whole || whole(row, slip(c, 0) + c.bias)) note(sweep(c, cone));
    });
    for_friction([&](PgsJointFriction<float>& f) { note(sweep(f)); });
    result.residual = worst;
    if (renews_rubbing(++result.sweeps))
      for_contacts(false, [](IslandContact& row) {
        if (row.whole) set_rubbing_step(row.solver);
      });
  } while (result.sweeps < most_sweeps && !(result.residual < tolerance));
  return result;
}

// Finds the largest impulse and the shifts of an island, after sweep_rates.
template <class ForContacts, class ForFriction, class Complete>
void finish_sweeps(const ForContacts& for_contacts, const ForFriction& for_friction,
                   const Complete& complete, IslandResult& result) {
  const auto note = [&](float size) {
    result.largest = result.largest < size ? size : result.largest;
  };
  for_contacts(false,
               [&](const IslandContact& row) { note(row.solver.normal * row.solver.impulse[0]); });
  for_friction(
      [&](const PgsJointFriction<float>& f) { note(math::abs(f.response[f.dof] * f.impulse)); });
  sweep_shifts([&](const auto& f) { for_contacts(false, f); }, completes_pushing(complete));
}

}  // namespace novaphy::articulation
