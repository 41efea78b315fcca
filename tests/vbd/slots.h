// Slots of single elements, for tests of their laws.
#pragma once

#include <initializer_list>
#include <span>

#include "novaphy/vbd/elements/list.h"

namespace novaphy::testing {

using vbd::Role;

// Sets the numbers of a slot from parameters, without those of the start.
template <Role role, class S>
void set_numbers(vbd::SlotInputs<role, S>& in, int corner, std::initializer_list<S> parameters,
                 const S& h) {
  vbd::SlotOf<role>::put_numbers(corner, parameters.begin(), h,
                                 [&in](int k, const S& value) { in.numbers[k] = value; });
}
// Sets the numbers of the start, from other positions.
template <Role role, class S>
void set_start(vbd::SlotInputs<role, S>& in, const Vec3<S>& own, std::span<const Vec3<S>> others) {
  vbd::SlotInputs<role, S> before = in;
  before.own = own;
  for (size_t k = 0; k < others.size(); ++k) before.others[k] = others[k];
  vbd::SlotOf<role>::put_start(
      before, [&in](int k, const S& value) { in.numbers[vbd::start_begin(role) + k] = value; });
}
// A slot of corner c among the corners x, which began the step at xn.
template <Role role, class S>
vbd::SlotInputs<role, S> slot_of(int c, std::span<const Vec3<S>> x, std::span<const Vec3<S>> xn,
                                 std::initializer_list<S> parameters, const S& h) {
  vbd::SlotInputs<role, S> in;
  Vec3<S> before[vbd::kOthers[role]];
  in.own = x[static_cast<size_t>(c)];
  for (int k = 0; k < vbd::kOthers[role]; ++k) {
    const auto other = static_cast<size_t>(vbd::SlotOf<role>::other_corner(c, k));
    in.others[k] = x[other];
    before[k] = xn[other];
  }
  set_numbers(in, c, parameters, h);
  set_start<role, S>(in, xn[static_cast<size_t>(c)], before);
  return in;
}
// The energy and the force of a slot with the particle at x.
template <Role role, class S>
S energy_at(vbd::SlotInputs<role, S> in, const Vec3<S>& x) {
  in.own = x;
  return vbd::SlotOf<role>::energy(in);
}
template <Role role, class S>
Vec3<S> force_at(vbd::SlotInputs<role, S> in, const Vec3<S>& x) {
  in.own = x;
  return vbd::block_of(in, true).f;
}

}  // namespace novaphy::testing
