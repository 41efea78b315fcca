// Derivatives of the blocks of slots and contacts, as code that the build makes from the laws
// (tools/vbd_adjoints): of u.f + B:H, where `bar` holds u as f and B as h_ij, each entry once.
#pragma once

#include "sweep_slots.h"

namespace novaphy::vbd::NOVAPHY_LEVEL {

template <Role role>
struct SlotPoints {
  Point own, others[kOthers[role]];
};
template <Role role>
struct SlotBars {
  Point own, others[kOthers[role]];
  Lanes numbers[kFloats[role]];
};
struct ContactBars {
  Point x, start;
  Lanes law[kContactLawFloats];
};

// `at_rest`: B is 0. `weights`: also by the weights of the other particles.
template <bool at_rest, bool damped, bool weights, Role role>
void slot_adjoint(const Slot<role>& slot, const SlotPoints<role>& x, const Block<Lanes>& bar,
                  SlotBars<role>& to);
// Of what the slot has of the start.
template <bool weights, Role role>
void start_adjoint(const Slot<role>& slot, const SlotPoints<role>& x,
                   const Lanes (&bar)[kStartFloats[role]], SlotBars<role>& to);
template <bool at_rest>
void contact_adjoint(const Point& x, const Point& start, const ParticleContact<Lanes>& c,
                     const Block<Lanes>& bar, ContactBars& to);

#include "slot_adjoints.inc"

}  // namespace novaphy::vbd::NOVAPHY_LEVEL
