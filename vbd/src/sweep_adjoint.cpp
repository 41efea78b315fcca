// The sweep of one instruction set in reverse.
//
// A particle moves by d = H^-1 f. With u = H^-T xbar, the derivative of d.xbar by anything that f
// and H read is that of phi = u.f - u.(H d), u and d held constant. phi is a sum over slots.
#include "reverse.h"
#include "slot_inputs.h"

namespace novaphy::vbd::NOVAPHY_VBD_LEVEL {
namespace {

void add_row(float* rows, int32_t particle, const Point& value, int32_t lane) {
  float* const row = rows + 4 * static_cast<int64_t>(particle);
  row[0] += value.x.v[lane];
  row[1] += value.y.v[lane];
  row[2] += value.z.v[lane];
}

// The particles of a group in reverse: u and d of their steps, and what they add to their own bars.
struct Moved {
  Point u, d, own;

  Reverse phi(const Block<Reverse>& block) const {
    return math::dot(constant(u), block.f) -
           math::dot(constant(u), multiply_stiffness(block, constant(d)));
  }
};

// `first`: the first number of the slot that derivatives are by.
template <Role role>
SlotInputs<role, Reverse> inputs_of(Trace& trace, const Slot<role>& slot, const Point& x,
                                    const float* q, int first) {
  SlotInputs<role, Reverse> in;
  trace.clear();
  in.own = input(trace, x);
  for (int k = 0; k < kOthers[role]; ++k)
    in.others[k] = input(trace, gather(q, slot.index(in.place(k))));
  for (int k = 0; k < kFloats[role]; ++k)
    in.numbers[k] = k < first ? Reverse(slot.number(k)) : Reverse::input(trace, slot.number(k));
  return in;
}

template <Role role>
float* rows_of(float* const (&tables)[kRoles], const SlotTable& table, const Slot<role>& slot,
               int width) {
  return tables[role] + slot_number(table, slot) * (width * LANES);
}

template <Role role>
void put_others(const Sweep& sweep, const Adjoint& bars, const Slot<role>& slot,
                const SlotInputs<role, Reverse>& in) {
  float* const rows = rows_of(bars.others, sweep.slots[role], slot, 3 * kOthers[role]);
  for (int k = 0; k < kOthers[role]; ++k) {
    const Point b = bar(in.others[k]);
    store(rows + (3 * k + 0) * LANES, b.x);
    store(rows + (3 * k + 1) * LANES, b.y);
    store(rows + (3 * k + 2) * LANES, b.z);
  }
}

// The numbers [first, last) of a slot.
template <Role role>
void add_numbers(float* rows, const SlotInputs<role, Reverse>& in, int first, int last) {
  for (int k = first; k < last; ++k)
    store(rows + k * LANES, load(rows + k * LANES) + in.numbers[k].bar());
}

template <Role role>
void adjoint_slots(const Sweep& sweep, const Adjoint& bars, int64_t group, const Point& x,
                   Trace& trace, Moved& moved) {
  const SlotTable& table = sweep.slots[role];
  const int first = bars.weights ? 0 : law_begin(role);
  for_slots<role>(sweep, group, [&](const Slot<role>& slot) {
    const auto in = inputs_of(trace, slot, x, sweep.x, first);
    const Reverse phi = moved.phi(block_of(in, table.damped));
    trace.run(phi.node);
    moved.own = moved.own + bar(in.own);
    put_others(sweep, bars, slot, in);
    add_numbers(rows_of(bars.numbers, table, slot, kFloats[role]), in, first, kFloats[role]);
  });
}

template <Role role>
void adjoint_start_slots(const Sweep& sweep, const Adjoint& bars, int64_t group, const Point& x,
                         Trace& trace, Point& own) {
  constexpr int end = kFloats[role] - kStartFloats[role];  // of the law
  const int first = bars.weights ? 0 : end;
  for_slots<role>(sweep, group, [&](const Slot<role>& slot) {
    const auto in = inputs_of(trace, slot, x, sweep.start, first);
    float* const rows = rows_of(bars.numbers, sweep.slots[role], slot, kFloats[role]);
    Reverse phi(0.0f);
    start_of_slot(in, [&](int k, const Reverse& value) {
      phi = phi + value * Reverse(load(rows + (end + k) * LANES));
    });
    trace.run(phi.node);
    own = own + bar(in.own);
    put_others(sweep, bars, slot, in);
    add_numbers(rows, in, first, end);
  });
}

// By the numbers of the law of the contacts of a group.
void add_contacts(const Sweep& sweep, const Adjoint& bars, int64_t group, int32_t round,
                  const Reverse (&law)[kContactLawFloats]) {
  for (int32_t l = 0; l < sweep.filled[group]; ++l) {
    const int32_t particle = sweep.particle[group * LANES + l];
    const int32_t k = sweep.contact_begin[particle] + round;
    if (k >= sweep.contact_begin[particle + 1]) continue;
    for (int c = 0; c < kContactLawFloats; ++c)
      bars.contacts[static_cast<int64_t>(k) * kContactLawFloats + c] += law[c].bar().v[l];
  }
}

void adjoint_contacts(const Sweep& sweep, const Adjoint& bars, int64_t group, const Point& x,
                      Trace& trace, Moved& moved, Point& by_start) {
  if (sweep.contact_begin == nullptr) return;
  const Point start = gather(sweep.start, sweep.particle + group * LANES);
  for_contacts(sweep, group, [&](const ParticleContact<Lanes>& c, Mask touching, int32_t round) {
    trace.clear();
    const Vec3<Reverse> xi = input(trace, x), si = input(trace, start);
    const Reverse law[kContactLawFloats] = {
        Reverse::input(trace, c.radius), Reverse::input(trace, c.ke),
        Reverse::input(trace, c.kd_by_h), Reverse::input(trace, c.mu)};
    const ParticleContact<Reverse> contact = {
        constant(c.point), constant(c.normal), constant(c.travel), law[0], law[1], law[2], law[3],
        Reverse(c.slip)};
    const Reverse phi = moved.phi(where(touching, particle_contact_block(xi, si, contact)));
    trace.run(phi.node);
    moved.own = moved.own + bar(xi);
    by_start = by_start + bar(si);
    add_contacts(sweep, bars, group, round, law);
  });
}

}  // namespace

void adjoint(const Sweep& sweep, const Adjoint& bars, int64_t group);
void adjoint_start(const Sweep& sweep, const Adjoint& bars, int64_t group);

void adjoint(const Sweep& sweep, const Adjoint& bars, int64_t group) {
  Trace trace;
  const int32_t* const particle = sweep.particle + group * LANES;
  const int32_t filled = sweep.filled[group];
  const Point x = gather(sweep.x, particle);
  Moved moved;
  Mask is_particle;
  for (int32_t l = 0; l < filled; ++l) is_particle.v[l] = -1;
  if (bars.multiplier != nullptr) {
    moved.u = gather(bars.multiplier, particle);
  } else {
    const Block<Lanes> block = block_at(sweep, group, x);
    const auto factors = factorize(block, Lanes(sweep.regularization));
    if (!bars.at_rest) moved.d = solve_block(factors, block.f);
    moved.u = solve_block(factors, gather(bars.x, particle));
  }
  moved.u = math::select(is_particle, moved.u, Point{});
  const Point inertia = moved.u * load(sweep.mass_by_h2 + group * LANES);
  moved.own = -inertia;
  const Lanes by_mass = math::dot(moved.u, (gather(sweep.target, particle) - x) - moved.d);

  Point by_start;
  adjoint_contacts(sweep, bars, group, x, trace, moved, by_start);
  adjoint_slots<kSpring>(sweep, bars, group, x, trace, moved);
  adjoint_slots<kTriangle>(sweep, bars, group, x, trace, moved);
  adjoint_slots<kHingeOpposite>(sweep, bars, group, x, trace, moved);
  adjoint_slots<kHingeEnd>(sweep, bars, group, x, trace, moved);
  adjoint_slots<kTetrahedron>(sweep, bars, group, x, trace, moved);
  for (int32_t l = 0; l < filled; ++l) {
    add_row(bars.own, particle[l], moved.own, l);
    add_row(bars.target, particle[l], inertia, l);
    add_row(bars.start, particle[l], by_start, l);
    bars.mass_by_h2[particle[l]] += by_mass.v[l];
    if (bars.multiplier_sum != nullptr) add_row(bars.multiplier_sum, particle[l], moved.u, l);
  }
}

void adjoint_start(const Sweep& sweep, const Adjoint& bars, int64_t group) {
  Trace trace;
  const int32_t* const particle = sweep.particle + group * LANES;
  const Point x = gather(sweep.start, particle);
  Point own;
  adjoint_start_slots<kSpring>(sweep, bars, group, x, trace, own);
  adjoint_start_slots<kTriangle>(sweep, bars, group, x, trace, own);
  adjoint_start_slots<kHingeOpposite>(sweep, bars, group, x, trace, own);
  adjoint_start_slots<kHingeEnd>(sweep, bars, group, x, trace, own);
  adjoint_start_slots<kTetrahedron>(sweep, bars, group, x, trace, own);
  for (int32_t l = 0; l < sweep.filled[group]; ++l) add_row(bars.own, particle[l], own, l);
}

}  // namespace novaphy::vbd::NOVAPHY_VBD_LEVEL
