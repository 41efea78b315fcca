// A color of VBD in reverse on devices, as three launches. On the CPU sweep_adjoint.cpp is the
// first two of them, and explains them. First, vbd_adjoint_solve finds the multipliers u and the
// steps d of the particles, a thread for each, or vbd_adjoint_solve_team by teams. Second,
// vbd_adjoint_slots finds the part of each slot for positions and parameters, a thread for each
// lane of a slot. Third, vbd_receive (vbd_gradient_kernels.h) adds the parts up in slot order.
#pragma once

#include "novaphy/vbd/lane_slots_kernels.h"
#include "novaphy/vbd/slot_teams_kernels.h"

namespace novaphy {

struct VbdAdjointArguments {
  NOVAPHY_ARGUMENTS(
      Part<VbdSweepArguments> sweep; Optional<Reads<VbdRow>>
          before;                 // where the particles of the colour stood; null: they are there
      Updates<VbdRow> x_bar;      // read; on the CPU also what particles give to their own
      Updates<VbdRow> u, d, own;  // what a particle gives to its own position, but for its slots
      Updates<VbdRow> start_bar, target_bar; Updates<float> mass_bar;  // by mass/h^2
      Optional<Updates<float>> contact_bars;     // kContactLawFloats for each contact of the step
      Number<int64_t> at_rest;                   // at a solution, where f = 0: with d = 0
      Optional<Updates<VbdRow>> multiplier;      // at rest: u, instead of solving for it; else null
      Optional<Updates<VbdRow>> multiplier_sum;  // of u; null: not wanted
      Reads<int32_t> slot_particle;              // of each lane of each slot of each role; -1: none
      Updates<float> terms;            // of slots, 3 rows for their own and each other particle
      Updates<float> numbers;          // of slots, by all their numbers
      Reads<int64_t> begins;           // where roles begin in these three: 5 numbers for each
      Each<Number<int64_t>, 5> first;  // by role: the first lane of the slots of the launch
      Each<Number<int64_t>, 5> ends;   // by role: threads up to its last one
  )
};

// "weights": also by the weights of slots; "rest": vbd_adjoint_slots at a solution; "start": of
// what slots have of the start.
NOVAPHY_BLOCK_KERNEL(vbd_adjoint_solve, VbdAdjointArguments);
NOVAPHY_BLOCK_KERNEL(vbd_adjoint_solve_team, VbdAdjointArguments);
NOVAPHY_BLOCK_KERNEL(vbd_adjoint_slots, VbdAdjointArguments);
NOVAPHY_BLOCK_KERNEL(vbd_adjoint_weights, VbdAdjointArguments);
NOVAPHY_BLOCK_KERNEL(vbd_adjoint_rest, VbdAdjointArguments);
NOVAPHY_BLOCK_KERNEL(vbd_adjoint_rest_weights, VbdAdjointArguments);
NOVAPHY_BLOCK_KERNEL(vbd_adjoint_start, VbdAdjointArguments);
NOVAPHY_BLOCK_KERNEL(vbd_adjoint_start_weights, VbdAdjointArguments);

#ifdef NOVAPHY_KERNEL
namespace vbd {
// The derivatives of the laws, of floats.
namespace floats {
using Lanes = float;
using Point = Vec3f;
template <Role role>
using Slot = LaneSlot<role>;
using math::both;
using math::select;
using math::sqrt;
#define NOVAPHY_LANE_FN inline
#include "slot_adjoints.inc"
#undef NOVAPHY_LANE_FN
}  // namespace floats

inline void add(VbdRow* rows, int32_t p, const Vec3f& v) { rows[p] = to_row(at(rows, p) + v); }

// One lane of a slot, the k-th of its role in the launch: where it is, and what it reads at q.
template <Role role>
struct AdjointSlot {
  int64_t number;
  int32_t lane, particle;
  floats::SlotPoints<role> x;
  AdjointSlot(const VbdAdjointArguments& a, const VbdRow* q, int64_t k) {
    const int64_t i = a.first[role] + k;
    number = i / kVbdLanes;
    lane = static_cast<int32_t>(i - number * kVbdLanes);
    particle = a.slot_particle[a.begins[role] + i];
    if (particle < 0) return;
    const LaneSlot<role> slot(a.sweep, number, lane);
    x.own = at(q, particle);
#pragma unroll
    for (int o = 0; o < kOthers[role]; ++o) x.others[o] = at(q, slot.index(other_place<role>(o)));
  }
  float* numbers(const VbdAdjointArguments& a) const {
    return a.numbers + a.begins[2 * kRoles + role] + number * (kFloats[role] * kVbdLanes) + lane;
  }
  void put_terms(const VbdAdjointArguments& a, const floats::SlotBars<role>& of) const {
    constexpr int kPoints = 1 + kOthers[role];
    float* const to = a.terms + a.begins[kRoles + role] + number * (kPoints * 3 * kVbdLanes) + lane;
#pragma unroll
    for (int o = 0; o < kPoints; ++o) {
      const Vec3f& v = o == 0 ? of.own : of.others[o > 0 ? o - 1 : 0];
      to[(3 * o) * kVbdLanes] = v.x;
      to[(3 * o + 1) * kVbdLanes] = v.y;
      to[(3 * o + 2) * kVbdLanes] = v.z;
    }
  }
  // The numbers [first, last).
  void add_numbers(const VbdAdjointArguments& a, const floats::SlotBars<role>& of, int first,
                   int last) const {
    float* const to = numbers(a);
#pragma unroll
    for (int k = 0; k < kFloats[role]; ++k)
      if (k >= first && k < last) to[k * kVbdLanes] = to[k * kVbdLanes] + of.numbers[k];
  }
};

template <bool at_rest, Role role, bool damped, bool weights>
inline void reverse_slot(const VbdAdjointArguments& a, int64_t k) {
  const AdjointSlot<role> at_slot(a, a.sweep.x, k);
  if (at_slot.particle < 0) return;
  const Block<float> bar = bars_of(at(a.u, at_slot.particle), at(a.d, at_slot.particle));
  floats::SlotBars<role> to;
  floats::slot_adjoint<at_rest, damped, weights>(
      LaneSlot<role>(a.sweep, at_slot.number, at_slot.lane), at_slot.x, bar, to);
  at_slot.put_terms(a, to);
  at_slot.add_numbers(a, to, weights ? 0 : law_begin(role), kFloats[role]);
}
template <Role role, bool weights>
inline void reverse_start(const VbdAdjointArguments& a, int64_t k) {
  constexpr int kLaw = law_begin(role), kStart = kLaw + kLawFloats[role];
  const AdjointSlot<role> at_slot(a, a.sweep.start, k);
  if (at_slot.particle < 0) return;
  float bar[kStartFloats[role]];
  const float* const numbers = at_slot.numbers(a);
#pragma unroll
  for (int i = 0; i < kStartFloats[role]; ++i) bar[i] = numbers[(kStart + i) * kVbdLanes];
  floats::SlotBars<role> to;
  floats::start_adjoint<weights>(LaneSlot<role>(a.sweep, at_slot.number, at_slot.lane), at_slot.x,
                                 bar, to);
  at_slot.put_terms(a, to);
  if (weights) at_slot.add_numbers(a, to, 0, kLaw);
}

template <bool at_rest, bool weights>
inline void reverse_slots(const VbdAdjointArguments& a, int64_t row) {
  if (row < a.ends[0]) {
    reverse_slot<at_rest, kSpring, true, false>(a, row);
  } else if (row < a.ends[1]) {
    const int64_t k = row - a.ends[0];
    if ((a.sweep.damped >> kTriangle) & 1) {
      reverse_slot<at_rest, kTriangle, true, weights>(a, k);
    } else {
      reverse_slot<at_rest, kTriangle, false, weights>(a, k);
    }
  } else if (row < a.ends[2]) {
    reverse_slot<at_rest, kHingeOpposite, true, false>(a, row - a.ends[1]);
  } else if (row < a.ends[3]) {
    reverse_slot<at_rest, kHingeEnd, true, false>(a, row - a.ends[2]);
  } else if (row < a.ends[4]) {
    const int64_t k = row - a.ends[3];
    if ((a.sweep.damped >> kTetrahedron) & 1) {
      reverse_slot<at_rest, kTetrahedron, true, weights>(a, k);
    } else {
      reverse_slot<at_rest, kTetrahedron, false, weights>(a, k);
    }
  }
}
template <bool weights>
inline void reverse_starts(const VbdAdjointArguments& a, int64_t row) {
  if (row < a.ends[0]) {
    reverse_start<kSpring, false>(a, row);
  } else if (row < a.ends[1]) {
    reverse_start<kTriangle, weights>(a, row - a.ends[0]);
  } else if (row < a.ends[2]) {
    reverse_start<kHingeOpposite, false>(a, row - a.ends[1]);
  } else if (row < a.ends[3]) {
    reverse_start<kHingeEnd, false>(a, row - a.ends[2]);
  } else if (row < a.ends[4]) {
    reverse_start<kTetrahedron, weights>(a, row - a.ends[3]);
  }
}

// Finds u and d of a particle from its block, and what its inertia and contacts give.
struct SolveParticle {
  const VbdAdjointArguments& a;
  explicit SolveParticle(const VbdAdjointArguments& arguments) : a(arguments) {}
  void ask(int32_t) {}
  Vec3f place(int32_t p) const { return at(a.before != nullptr ? a.before : a.sweep.x, p); }
  void put(int32_t p, int64_t k, const Block<float>& block) {
    const VbdSweepArguments& s = a.sweep;
    const Vec3f x = place(p);
    if (a.before != nullptr) s.x[p] = to_row(x);
    Vec3f u, d{};
    if (a.multiplier != nullptr) {
      u = at(a.multiplier, p);
    } else {
      const auto factors = factorize(block, s.regularization.value);
      if (a.at_rest == 0) d = solve_block(factors, block.f);
      u = solve_block(factors, at(a.x_bar, p));
    }
    const Block<float> bar = bars_of(u, d);
    const Vec3f inertia = u * s.mass_by_h2[k];
    Vec3f own = -inertia, by_start{};
    if (s.contact_begin != nullptr) {
      const Vec3f start = at(s.start, p);
      for (int32_t c = s.contact_begin[p]; c < s.contact_begin[p + 1]; ++c) {
        floats::ContactBars to;
        if (a.at_rest != 0) {
          floats::contact_adjoint<true>(x, start, contact_of(s, c), bar, to);
        } else {
          floats::contact_adjoint<false>(x, start, contact_of(s, c), bar, to);
        }
        own = own + to.x;
        by_start = by_start + to.start;
        float* const law = a.contact_bars + static_cast<int64_t>(c) * kContactLawFloats;
#pragma unroll
        for (int i = 0; i < kContactLawFloats; ++i) law[i] = law[i] + to.law[i];
      }
    }
    a.mass_bar[p] = a.mass_bar[p] + math::dot(u, (at(s.target, p) - x) - d);
    a.u[p] = to_row(u);
    a.d[p] = to_row(d);
    a.own[p] = to_row(own);
    add(a.target_bar, p, inertia);
    add(a.start_bar, p, by_start);
    if (a.multiplier_sum != nullptr) add(a.multiplier_sum, p, u);
  }
};

inline int64_t row_of(int64_t block) { return block * 128 + static_cast<int64_t>(threadIdx.x); }

}  // namespace vbd

NOVAPHY_BLOCK_BODY(vbd_adjoint_solve, VbdAdjointArguments) {
  using namespace vbd;
  const VbdSweepArguments& s = a.sweep;
  const int64_t row = row_of(block), of_color = row / kVbdLanes, group = s.first_group + of_color;
  const auto lane = static_cast<int32_t>(row - of_color * kVbdLanes);
  if (group >= s.end_group || lane >= s.filled[group]) return;
  const int64_t k = group * kVbdLanes + lane;
  const int32_t p = s.particle[k];
  SolveParticle finish(a);
  finish.put(p, k,
             a.multiplier != nullptr ? Block<float>{} : block_at(s, group, lane, finish.place(p)));
}
NOVAPHY_BLOCK_BODY(vbd_adjoint_solve_team, VbdAdjointArguments) {
  __shared__ vbd::TeamMemory memory;
  vbd::for_teams<vbd::SolveParticle>(a.sweep, a, a.sweep.first_group, a.sweep.end_group, block,
                                     blocks, memory);
}
NOVAPHY_BLOCK_BODY(vbd_adjoint_slots, VbdAdjointArguments) {
  vbd::reverse_slots<false, false>(a, vbd::row_of(block));
}
NOVAPHY_BLOCK_BODY(vbd_adjoint_weights, VbdAdjointArguments) {
  vbd::reverse_slots<false, true>(a, vbd::row_of(block));
}
NOVAPHY_BLOCK_BODY(vbd_adjoint_rest, VbdAdjointArguments) {
  vbd::reverse_slots<true, false>(a, vbd::row_of(block));
}
NOVAPHY_BLOCK_BODY(vbd_adjoint_rest_weights, VbdAdjointArguments) {
  vbd::reverse_slots<true, true>(a, vbd::row_of(block));
}
NOVAPHY_BLOCK_BODY(vbd_adjoint_start, VbdAdjointArguments) {
  vbd::reverse_starts<false>(a, vbd::row_of(block));
}
NOVAPHY_BLOCK_BODY(vbd_adjoint_start_weights, VbdAdjointArguments) {
  vbd::reverse_starts<true>(a, vbd::row_of(block));
}
#endif

}  // namespace novaphy
