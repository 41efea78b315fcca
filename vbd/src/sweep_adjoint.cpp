// The sweep of one instruction set in reverse.
//
// A particle moves by d = H^-1 f. With u = H^-T xbar, the derivative of d.xbar by anything that f
// and H read is that of u.f - u.(H d), u and d held constant: a sum over slots.
#include "slot_adjoints.h"

namespace novaphy::vbd::NOVAPHY_LEVEL {
namespace {

void add_row(float* rows, int32_t particle, const Point& value, int32_t lane) {
  float* const row = rows + 4 * static_cast<int64_t>(particle);
  row[0] += value.x.v[lane];
  row[1] += value.y.v[lane];
  row[2] += value.z.v[lane];
}

template <Role role>
SlotPoints<role> points_of(const Slot<role>& slot, const Point& own, const float* q) {
  SlotPoints<role> x;
  x.own = own;
  for (int k = 0; k < kOthers[role]; ++k) x.others[k] = gather(q, slot.index(other_place<role>(k)));
  return x;
}

template <Role role>
float* rows_of(float* const (&tables)[kRoles], const SlotTable& table, const Slot<role>& slot,
               int width) {
  return tables[role] + slot_number(table, slot) * (width * LANES);
}

template <Role role>
void put_others(const Sweep& sweep, const Adjoint& bars, const Slot<role>& slot,
                const SlotBars<role>& of) {
  float* const rows = rows_of(bars.others, sweep.slots[role], slot, 3 * kOthers[role]);
  for (int k = 0; k < kOthers[role]; ++k) {
    store(rows + (3 * k + 0) * LANES, of.others[k].x);
    store(rows + (3 * k + 1) * LANES, of.others[k].y);
    store(rows + (3 * k + 2) * LANES, of.others[k].z);
  }
}

// The numbers [first, last) of a slot.
template <Role role>
void add_numbers(float* rows, const SlotBars<role>& of, int first, int last) {
  for (int k = first; k < last; ++k)
    store(rows + k * LANES, load(rows + k * LANES) + of.numbers[k]);
}

template <bool at_rest, bool damped, bool weights, Role role>
void adjoint_slots(const Sweep& sweep, const Adjoint& bars, int64_t group, const Point& x,
                   const Block<Lanes>& bar, Point& own) {
  const SlotTable& table = sweep.slots[role];
  for_slots<role>(sweep, group, [&](const Slot<role>& slot) {
    SlotBars<role> to;
    slot_adjoint<at_rest, damped, weights>(slot, points_of(slot, x, sweep.x), bar, to);
    own = own + to.own;
    put_others(sweep, bars, slot, to);
    add_numbers(rows_of(bars.numbers, table, slot, kFloats[role]), to,
                weights ? 0 : law_begin(role), kFloats[role]);
  });
}

template <Role role, bool weights>
void adjoint_start_slots(const Sweep& sweep, const Adjoint& bars, int64_t group, const Point& x,
                         Point& own) {
  constexpr int end = law_begin(role) + kLawFloats[role];
  for_slots<role>(sweep, group, [&](const Slot<role>& slot) {
    float* const rows = rows_of(bars.numbers, sweep.slots[role], slot, kFloats[role]);
    Lanes bar[kStartFloats[role]];
    for (int k = 0; k < kStartFloats[role]; ++k) bar[k] = load(rows + (end + k) * LANES);
    SlotBars<role> to;
    start_adjoint<weights>(slot, points_of(slot, x, sweep.start), bar, to);
    own = own + to.own;
    put_others(sweep, bars, slot, to);
    if (weights) add_numbers(rows, to, 0, law_begin(role));
  });
}

// By the numbers of the law of the contacts of a group.
void add_contacts(const Sweep& sweep, const Adjoint& bars, int64_t group, int32_t round,
                  const Lanes (&law)[kContactLawFloats]) {
  for (int32_t l = 0; l < sweep.filled[group]; ++l) {
    const int32_t particle = sweep.particle[group * LANES + l];
    const int32_t k = sweep.contact_begin[particle] + round;
    if (k >= sweep.contact_begin[particle + 1]) continue;
    for (int c = 0; c < kContactLawFloats; ++c)
      bars.contacts[static_cast<int64_t>(k) * kContactLawFloats + c] += law[c].v[l];
  }
}

template <bool at_rest>
void adjoint_contacts(const Sweep& sweep, const Adjoint& bars, int64_t group, const Point& x,
                      const Block<Lanes>& bar, Point& own, Point& by_start) {
  if (sweep.contact_begin == nullptr) return;
  const Point start = gather(sweep.start, sweep.particle + group * LANES);
  for_contacts(sweep, group, [&](const ParticleContact<Lanes>& c, Mask touching, int32_t round) {
    ContactBars to;
    contact_adjoint<at_rest>(x, start, c, bar, to);
    own = own + math::select(touching, to.x, Point{});
    by_start = by_start + math::select(touching, to.start, Point{});
    add_contacts(sweep, bars, group, round, to.law);
  });
}

template <bool at_rest, bool weights>
void adjoint_elements(const Sweep& sweep, const Adjoint& bars, int64_t group, const Point& x,
                      const Block<Lanes>& bar, Point& own, Point& by_start) {
  adjoint_contacts<at_rest>(sweep, bars, group, x, bar, own, by_start);
  adjoint_slots<at_rest, true, false, kSpring>(sweep, bars, group, x, bar, own);
  if (sweep.slots[kTriangle].damped) {
    adjoint_slots<at_rest, true, weights, kTriangle>(sweep, bars, group, x, bar, own);
  } else {
    adjoint_slots<at_rest, false, weights, kTriangle>(sweep, bars, group, x, bar, own);
  }
  adjoint_slots<at_rest, true, false, kHingeOpposite>(sweep, bars, group, x, bar, own);
  adjoint_slots<at_rest, true, false, kHingeEnd>(sweep, bars, group, x, bar, own);
  if (sweep.slots[kTetrahedron].damped) {
    adjoint_slots<at_rest, true, weights, kTetrahedron>(sweep, bars, group, x, bar, own);
  } else {
    adjoint_slots<at_rest, false, weights, kTetrahedron>(sweep, bars, group, x, bar, own);
  }
}

}  // namespace

void adjoint(const Sweep& sweep, const Adjoint& bars, int64_t group);
void adjoint_start(const Sweep& sweep, const Adjoint& bars, int64_t group);

void adjoint(const Sweep& sweep, const Adjoint& bars, int64_t group) {
  const int32_t* const particle = sweep.particle + group * LANES;
  const int32_t filled = sweep.filled[group];
  const Point x = gather(sweep.x, particle);
  Point u, d;
  Mask is_particle;
  for (int32_t l = 0; l < filled; ++l) is_particle.v[l] = -1;
  if (bars.multiplier != nullptr) {
    u = gather(bars.multiplier, particle);
  } else {
    const Block<Lanes> block = block_at(sweep, group, x);
    const auto factors = factorize(block, Lanes(sweep.regularization));
    if (!bars.at_rest) d = solve_block(factors, block.f);
    u = solve_block(factors, gather(bars.x, particle));
  }
  u = math::select(is_particle, u, Point{});
  const Block<Lanes> bar = bars_of(u, d);
  const Point inertia = u * load(sweep.mass_by_h2 + group * LANES);
  const Lanes by_mass = math::dot(u, (gather(sweep.target, particle) - x) - d);

  Point own = -inertia, by_start;
  if (bars.at_rest) {
    if (bars.weights) {
      adjoint_elements<true, true>(sweep, bars, group, x, bar, own, by_start);
    } else {
      adjoint_elements<true, false>(sweep, bars, group, x, bar, own, by_start);
    }
  } else if (bars.weights) {
    adjoint_elements<false, true>(sweep, bars, group, x, bar, own, by_start);
  } else {
    adjoint_elements<false, false>(sweep, bars, group, x, bar, own, by_start);
  }
  for (int32_t l = 0; l < filled; ++l) {
    add_row(bars.x, particle[l], own, l);
    add_row(bars.target, particle[l], inertia, l);
    add_row(bars.start, particle[l], by_start, l);
    bars.mass_by_h2[particle[l]] += by_mass.v[l];
    if (bars.multiplier_sum != nullptr) add_row(bars.multiplier_sum, particle[l], u, l);
  }
}

void adjoint_start(const Sweep& sweep, const Adjoint& bars, int64_t group) {
  const int32_t* const particle = sweep.particle + group * LANES;
  const Point x = gather(sweep.start, particle);
  Point own;
  adjoint_start_slots<kSpring, false>(sweep, bars, group, x, own);
  if (bars.weights) {
    adjoint_start_slots<kTriangle, true>(sweep, bars, group, x, own);
  } else {
    adjoint_start_slots<kTriangle, false>(sweep, bars, group, x, own);
  }
  adjoint_start_slots<kHingeOpposite, false>(sweep, bars, group, x, own);
  adjoint_start_slots<kHingeEnd, false>(sweep, bars, group, x, own);
  if (bars.weights) {
    adjoint_start_slots<kTetrahedron, true>(sweep, bars, group, x, own);
  } else {
    adjoint_start_slots<kTetrahedron, false>(sweep, bars, group, x, own);
  }
  for (int32_t l = 0; l < sweep.filled[group]; ++l) add_row(bars.start, particle[l], own, l);
}

}  // namespace novaphy::vbd::NOVAPHY_LEVEL
