// The adjoint of a sweep (sweep_kernels.h). A particle moves by d = H^-1 f. Let xbar be the adjoint
// of the new position, and u = H^-T xbar. The derivative of d.xbar with respect to each input of f
// and H is the derivative of u.f - u.(H d) with constant u and d. This expression is a sum over
// slots. The build derives the adjoint laws of slots (tools/vbd_adjoints).
//
// On the CPU one call handles a whole group. On a device, threads for particles compute u and d and
// store them. Threads for lanes of slots then compute the adjoints of the slots' inputs.
#pragma once

#include "novaphy/vbd/sweep_kernels.h"

namespace novaphy {

// The adjoints that a reverse sweep reads and writes. The sweep adds to its outputs unless a
// comment says otherwise.
struct VbdAdjointArguments {
  NOVAPHY_ARGUMENTS(
      Part<VbdSweepArguments> sweep; Optional<Reads<VbdRow>>
          before;  // positions of the particles before the color moved; null: those in x
      Updates<VbdRow> x_adjoint;  // input; the CPU also adds each particle's own adjoint
      Updates<VbdRow> u, d, own;  // own: adjoint of the own position, without slots
      // mass_adjoint is the adjoint of mass/h^2
      Updates<VbdRow> start_adjoint, target_adjoint;
      Updates<float> mass_adjoint;
      Optional<Updates<float>> contact_adjoints;  // kContactLawFloats for each contact of the step
      Number<int64_t> at_solution;                // 1: at a solution, where f = 0 and d = 0
      Number<int64_t> weights;                    // 1: also the adjoints of the weights of slots
      Optional<Updates<VbdRow>> multiplier;       // null: the kernel solves for u; else the given u
      Optional<Reads<VbdRow>> after;              // with a given u: d = after - before; null: d = 0
      Optional<Updates<VbdRow>> multiplier_sum;   // the sum of u; null: not wanted
      // the particle of each lane of each slot of each role; -1: no particle
      Reads<int32_t> slot_particle;
      // for each slot: 3 rows for each of the other corners; on devices also 3 rows for the slot's
      // own particle, which come first
      Updates<float> terms; Updates<float> numbers;  // adjoints of all numbers of a slot
      Reads<int64_t> begins;  // first index of each role in slot_particle, terms, numbers
      Each<Number<int64_t>, vbd::kRoles> first;  // for each role: first lane of its slots
      // for each role: the number of threads of the launch for the roles up to this one
      Each<Number<int64_t>, vbd::kRoles> ends;)
};

namespace vbd {

#include "slot_adjoints.inc"

template <Role role, class S>
float* adjoints_of_numbers(const VbdAdjointArguments& a, const Slot<role, S>& slot) {
  return a.numbers + (a.begins[2 * kRoles + role] + (slot.floats - a.sweep.floats[role]));
}
// Adds the adjoints of the numbers of a slot with an index below `last`. The function skips the
// weights unless a.weights is 1.
template <Role role, class S>
void add_numbers(const VbdAdjointArguments& a, const Slot<role, S>& slot,
                 const SlotAdjoints<role, S>& of, int last) {
  using Access = LaneAccess<S>;
  float* const to = adjoints_of_numbers(a, slot);
  for (int k = a.weights != 0 ? 0 : law_begin(role); k < last; ++k)
    Access::store(to + k * Access::kStride, Access::load(to + k * Access::kStride) + of.numbers[k]);
}
// Stores the adjoints of the positions of the other corners, or adds to stored ones if `adds`. On
// devices the adjoint of the own position comes first.
template <Role role, class S>
void put_terms(const VbdAdjointArguments& a, const Slot<role, S>& slot,
               const SlotAdjoints<role, S>& of, bool adds = false) {
  using Access = LaneAccess<S>;
  constexpr int kOwn = Access::kLanes == 1 ? 1 : 0, kPoints = kOthers[role] + kOwn;
  float* const to = a.terms + (a.begins[kRoles + role] +
                               slot.number * (kPoints * 3 * Access::kStride) + slot.lane);
  const auto put = [to, adds](int point, const Vec3<S>& v) {
    const S all[3] = {v.x, v.y, v.z};
    for (int c = 0; c < 3; ++c) {
      float* const at = to + (3 * point + c) * Access::kStride;
      Access::store(at, adds ? Access::load(at) + all[c] : all[c]);
    }
  };
  if (kOwn != 0) put(0, of.own);
  for (int k = 0; k < kOthers[role]; ++k) put(kOwn + k, of.others[k]);
}

template <Role role>
constexpr bool kHasWeights = law_begin(role) > 0;

template <bool at_solution, bool damped, Role role, class S>
Vec3<S> reverse_slot_of(const VbdAdjointArguments& a, const Slot<role, S>& slot, const Vec3<S>& x,
                        const Block<S>& adjoint) {
  SlotAdjoints<role, S> to;
  slot_adjoint(SlotCase<at_solution, damped>(), inputs_apart(slot, x, a.sweep.x), adjoint, to);
  put_terms(a, slot, to);
  add_numbers(a, slot, to, kFloats[role]);
  return to.own;
}
// Computes the adjoints of the inputs of u.(sum_k H_k d[k]), with the H_k of stiffness().
template <Role role, class S>
NOVAPHY_LANE_FN_APART void stiffness_adjoint_of(const Slot<role, S>& slot, const Vec3<S>& x,
                                                const VbdRow* rows, const Vec3<S>& u,
                                                const Vec3<S>* d, SlotAdjoints<role, S>& to) {
  stiffness_adjoint(u, inputs_of(slot, x, rows), d, to);
}
// Stores the adjoints of -u.(sum_k H_k d[k]) as the terms of the slot, or adds to the terms if
// `adds`. Also adds the adjoints of the slot's numbers. Returns the adjoint of the own position.
template <Role role, class S>
Vec3<S> reverse_stiffness_of(const VbdAdjointArguments& a, const Slot<role, S>& slot,
                             const Vec3<S>& x, const Vec3<S>& u, const Vec3<S>* d, bool adds) {
  SlotAdjoints<role, S> to;
  stiffness_adjoint_of(slot, x, a.sweep.x, -u, d, to);
  put_terms(a, slot, to, adds);
  add_numbers(a, slot, to, kFloats[role]);
  return to.own;
}
// Computes the adjoints of a slot's law for a particle at x. Returns the adjoint of x.
template <bool at_solution, Role role, class S>
Vec3<S> reverse_slot(const VbdAdjointArguments& a, const Slot<role, S>& slot, const Vec3<S>& x,
                     const Block<S>& adjoint) {
  if constexpr (kHasWeights<role>)
    if (((a.sweep.damped >> role) & 1) == 0)
      return reverse_slot_of<at_solution, false>(a, slot, x, adjoint);
  return reverse_slot_of<at_solution, true>(a, slot, x, adjoint);
}
// Returns whether the block of a slot uses the H_0 of stiffness() (argument `turns` of block_of).
template <Role role, class S>
bool turns(const VbdAdjointArguments& a, const Slot<role, S>&) {
  return SlotOf<role>::kResistsTurns && a.sweep.turns != 0;
}
// Adds the adjoints of -u.(H_0 d), for a slot whose block uses H_0. Returns the adjoint of the own
// position.
template <Role role, class S>
Vec3<S> reverse_turning(const VbdAdjointArguments& a, const Slot<role, S>& slot, const Vec3<S>& x,
                        const Vec3<S>& u, const Vec3<S>& d) {
  if constexpr (!SlotOf<role>::kResistsTurns) {
    return {};
  } else {
    const Vec3<S> steps[kOthers[role] + 1] = {d};
    return reverse_stiffness_of(a, slot, x, u, steps, true);
  }
}
// Computes the adjoints of the law that gives a slot's values at the start of the step. x is the
// position of the own particle at the start. Returns the adjoint of x.
template <Role role, class S>
Vec3<S> reverse_start(const VbdAdjointArguments& a, const Slot<role, S>& slot, const Vec3<S>& x) {
  using Access = LaneAccess<S>;
  const float* const numbers = adjoints_of_numbers(a, slot);
  S adjoint[kStartFloats[role]];
  for (int k = 0; k < kStartFloats[role]; ++k)
    adjoint[k] = Access::load(numbers + (start_begin(role) + k) * Access::kStride);
  SlotAdjoints<role, S> to;
  start_adjoint(StartCase(), inputs_apart(slot, x, a.sweep.start), adjoint, to);
  put_terms(a, slot, to);
  add_numbers(a, slot, to, law_begin(role));
  return to.own;
}

// Moves the particles back to their positions before the color moved. Returns these positions.
template <class S>
Vec3<S> place_before(const VbdAdjointArguments& a, const LaneGroup<S>& g) {
  if (a.before == nullptr) return g.at(a.sweep.x);
  const Vec3<S> x = g.at(a.before);
  g.put(a.sweep.x, x);
  return x;
}

// Adds the adjoints of the inputs of contacts: the own position, the start and the coefficients.
template <class Case, class S>
void reverse_contacts(Case of, const VbdAdjointArguments& a, const LaneGroup<S>& g,
                      const Vec3<S>& x, const Block<S>& adjoint, Vec3<S>& own, Vec3<S>& by_start) {
  using math::select;
  if (a.sweep.contact_begin == nullptr) return;
  const Vec3<S> start = g.at(a.sweep.start);
  for_contacts(g, [&](const LaneContacts<S>& c) {
    ContactAdjoints<S> to;
    contact_adjoint(of, x, start, c.contact, adjoint, to);
    own = own + select(c.touching, to.x, Vec3<S>{});
    by_start = by_start + select(c.touching, to.start, Vec3<S>{});
    for (int l = 0; l < g.filled; ++l)
      for (int k = 0; c.number[l] >= 0 && k < kContactLawFloats; ++k) {
        float& law = a.contact_adjoints[static_cast<int64_t>(c.number[l]) * kContactLawFloats + k];
        law = law + LaneAccess<S>::get(to.law[k], l);
      }
  });
}

// Computes the multipliers u and the steps d of particles at x, from their blocks at x. Adds the
// adjoints of the inputs of inertia and contacts. `block` is not used if a.multiplier gives u.
template <class S>
struct Reversed {
  Vec3<S> u, d, own;
};
template <class S>
Reversed<S> reverse_particles(const VbdAdjointArguments& a, const LaneGroup<S>& g, const Vec3<S>& x,
                              const Block<S>& block) {
  using math::select;
  Reversed<S> to;
  if (a.multiplier != nullptr) {
    to.u = g.at(a.multiplier);
    if (a.after != nullptr) to.d = step_of<S>(a, g.particle);
  } else {
    const auto factors = factorize(block, S(a.sweep.regularization.value));
    if (a.at_solution == 0) to.d = solve_block(factors, block.f);
    to.u = solve_block(factors, g.at(a.x_adjoint));
  }
  MaskOf<S> is_particle{};
  for (int l = 0; l < g.filled; ++l) LaneAccess<S>::set(is_particle, l, true);
  to.u = select(is_particle, to.u, Vec3<S>{});
  const Vec3<S> inertia = to.u * g.mass_by_h2();
  const S by_mass = math::dot(to.u, (g.at(a.sweep.target) - x) - to.d);
  Vec3<S> by_start;
  to.own = -inertia;
  const Block<S> adjoint = adjoints_of(to.u, to.d);
  if (a.at_solution != 0) {
    reverse_contacts(ContactCase<true>(), a, g, x, adjoint, to.own, by_start);
  } else {
    reverse_contacts(ContactCase<false>(), a, g, x, adjoint, to.own, by_start);
  }
  g.add(a.target_adjoint, inertia);
  g.add(a.start_adjoint, by_start);
  for (int l = 0; l < g.filled; ++l) {
    float& mass = a.mass_adjoint[g.particle[l]];
    mass = mass + LaneAccess<S>::get(by_mass, l);
  }
  if (a.multiplier_sum != nullptr) g.add(a.multiplier_sum, to.u);
  return to;
}

// Computes the adjoint of the step of a group, with all its slots.
template <class S>
void reverse_group(const VbdAdjointArguments& a, const LaneGroup<S>& g) {
  const Vec3<S> x = place_before(a, g);
  Reversed<S> of =
      reverse_particles(a, g, x, a.multiplier != nullptr ? Block<S>() : block_at(g, x));
  const Block<S> adjoint = adjoints_of(of.u, of.d);
  for_roles([&](auto is) {
    constexpr Role role = decltype(is)::role;
    for_slots<role>(g, [&](const auto& slot) {
      const bool is_turning = a.at_solution == 0 && turns(a, slot);
      Vec3<S> own = a.at_solution != 0 || is_turning ? reverse_slot<true>(a, slot, x, adjoint)
                                                     : reverse_slot<false>(a, slot, x, adjoint);
      if (is_turning) own = own + reverse_turning(a, slot, x, of.u, of.d);
      of.own = of.own + own;
    });
  });
  g.add(a.x_adjoint, of.own);
}
template <class S>
void reverse_group_start(const VbdAdjointArguments& a, const LaneGroup<S>& g) {
  const Vec3<S> x = g.at(a.sweep.start);
  Vec3<S> own;
  for_roles([&](auto is) {
    for_slots<decltype(is)::role>(g,
                                  [&](const auto& slot) { own = own + reverse_start(a, slot, x); });
  });
  g.add(a.start_adjoint, own);
}

}  // namespace vbd
}  // namespace novaphy
