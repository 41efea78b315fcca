// The sweep of one instruction set in reverse.
//
// A particle moves by d = H^-1 f. With u = H^-T xbar, the derivative of d.xbar by anything that f
// and H read is that of phi = u.f - u.(H d), u and d held constant. phi is a sum over slots.
#include "reverse.h"
#include "sweep_slots.h"

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

// What a slot reads, as inputs of a trace.
template <Role role>
struct SlotInputs {
  Vec3<Reverse> own, others[3];
  Reverse numbers[kLawFloats[role] + kStartFloats[role]];  // the law, then the start

  SlotInputs(Trace& trace, const Slot<role>& slot, const Point& x, const float* q) {
    trace.clear();
    own = input(trace, x);
    for (int k = 0; k < kOthers[role]; ++k)
      others[k] = input(trace, gather(q, slot.index(place(k))));
    constexpr int count = kLawFloats[role] + kStartFloats[role];
    for (int k = 0; k < count; ++k)
      numbers[k] = Reverse::input(trace, slot.number(kFloats[role] - count + k));
  }
  // The row of indices of the k-th other.
  static constexpr int place(int k) {
    return kOwnPlace[role] < 0 || k < kOwnPlace[role] ? k : k + 1;
  }
};

template <Role role>
int64_t slot_number(const SlotTable& table, const Slot<role>& slot) {
  return (slot.ints - table.ints) / (kInts[role] * LANES);
}

Block<Reverse> block_of(const SlotInputs<kSpring>& in, const Slot<kSpring>&, bool) {
  return spring_block(in.own, in.others[0], {in.numbers[0], in.numbers[1], in.numbers[2]},
                      in.numbers[3]);
}
Vec2<Reverse> constant(const Vec2<Lanes>& w) { return {Reverse(w.x), Reverse(w.y)}; }
MembraneWeights<Reverse> constant(const MembraneWeights<Lanes>& w) {
  return {constant(w.w1), constant(w.w2)};
}
TetrahedronWeights<Reverse> constant(const TetrahedronWeights<Lanes>& w) {
  return {constant(w.w1), constant(w.w2), constant(w.w3)};
}
Block<Reverse> block_of(const SlotInputs<kTriangle>& in, const Slot<kTriangle>& slot, bool damped) {
  const Reverse* const n = in.numbers;
  return membrane_block(in.own, in.others[0], in.others[1], constant(weights_of(slot)),
                        {n[0], n[1], n[2], n[3]}, {n[4], n[5], n[6]}, damped);
}
Block<Reverse> block_of(const SlotInputs<kHingeOpposite>& in, const Slot<kHingeOpposite>&, bool) {
  return bending_opposite_block(in.own, in.others[0], in.others[1], in.others[2],
                                {in.numbers[0], in.numbers[1], in.numbers[2]}, in.numbers[3]);
}
Block<Reverse> block_of(const SlotInputs<kHingeEnd>& in, const Slot<kHingeEnd>&, bool) {
  return bending_end_block(in.others[0], in.others[1], in.own, in.others[2],
                           {in.numbers[0], in.numbers[1], in.numbers[2]}, in.numbers[3]);
}
Block<Reverse> block_of(const SlotInputs<kTetrahedron>& in, const Slot<kTetrahedron>& slot,
                        bool damped) {
  const Reverse* const n = in.numbers;
  return tetrahedron_block(in.own, in.others[0], in.others[1], in.others[2],
                           constant(weights_of(slot)), {n[0], n[1], n[2], n[3]},
                           {{n[4], n[5], n[6], n[7], n[8], n[9]}}, damped);
}

template <Role role>
void put_others(const Sweep& sweep, const Adjoint& bars, const Slot<role>& slot,
                const SlotInputs<role>& in) {
  float* const rows =
      bars.others[role] + slot_number(sweep.slots[role], slot) * (3 * kOthers[role] * LANES);
  for (int k = 0; k < kOthers[role]; ++k) {
    const Point b = bar(in.others[k]);
    store(rows + (3 * k + 0) * LANES, b.x);
    store(rows + (3 * k + 1) * LANES, b.y);
    store(rows + (3 * k + 2) * LANES, b.z);
  }
}

template <Role role>
void adjoint_slots(const Sweep& sweep, const Adjoint& bars, int64_t group, const Point& x,
                   Trace& trace, Moved& moved) {
  const SlotTable& table = sweep.slots[role];
  for_slots<role>(sweep, group, [&](const Slot<role>& slot) {
    const SlotInputs<role> in(trace, slot, x, sweep.x);
    const Reverse phi = moved.phi(block_of(in, slot, table.damped));
    trace.run(phi.node);
    moved.own = moved.own + bar(in.own);
    put_others(sweep, bars, slot, in);
    constexpr int count = kLawFloats[role] + kStartFloats[role];
    float* const rows = bars.laws[role] + slot_number(table, slot) * (count * LANES);
    for (int k = 0; k < count; ++k)
      store(rows + k * LANES, load(rows + k * LANES) + in.numbers[k].bar());
  });
}

// What a slot has of the start, as functions of xn.
template <Role role>
Reverse start_phi(const SlotInputs<role>& in, const Slot<role>& slot, const float* rows) {
  const auto row = [rows](int k) { return Reverse(load(rows + (kLawFloats[role] + k) * LANES)); };
  if constexpr (role == kSpring) {
    return spring_length(in.own, in.others[0]) * row(0);
  } else if constexpr (role == kTriangle) {
    const auto c = membrane_strain(in.own, in.others[0], in.others[1], constant(weights_of(slot)));
    return (c.c00 * row(0) + c.c01 * row(1)) + c.c11 * row(2);
  } else if constexpr (role == kTetrahedron) {
    const auto c = tetrahedron_strain(in.own, in.others[0], in.others[1], in.others[2],
                                      constant(weights_of(slot)));
    Reverse sum = c.c[0] * row(0);
    for (int k = 1; k < 6; ++k) sum = sum + c.c[k] * row(k);
    return sum;
  } else if constexpr (role == kHingeOpposite) {
    return bending_angle(in.own, in.others[0], in.others[1], in.others[2]) * row(0);
  } else {
    return bending_angle(in.others[0], in.others[1], in.own, in.others[2]) * row(0);
  }
}

template <Role role>
void adjoint_start_slots(const Sweep& sweep, const Adjoint& bars, int64_t group, const Point& x,
                         Trace& trace, Point& own) {
  const SlotTable& table = sweep.slots[role];
  for_slots<role>(sweep, group, [&](const Slot<role>& slot) {
    const SlotInputs<role> in(trace, slot, x, sweep.start);
    const float* const rows =
        bars.laws[role] +
        slot_number(table, slot) * ((kLawFloats[role] + kStartFloats[role]) * LANES);
    trace.run(start_phi(in, slot, rows).node);
    own = own + bar(in.own);
    put_others(sweep, bars, slot, in);
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
  const Block<Lanes> block = block_at(sweep, group, x);
  const auto factors = factorize(block, Lanes(sweep.regularization));
  Moved moved;
  moved.d = solve_block(factors, block.f);
  Mask is_particle;
  for (int32_t l = 0; l < filled; ++l) is_particle.v[l] = -1;
  moved.u = math::select(is_particle, solve_block(factors, gather(bars.x, particle)), Point{});
  const Point inertia = moved.u * load(sweep.mass_by_h2 + group * LANES);
  moved.own = -inertia;

  const Point start = gather(sweep.start, particle);
  Point by_start;
  for_contacts(sweep, group, [&](const ParticleContact<Lanes>& c, Mask touching) {
    trace.clear();
    const Vec3<Reverse> xi = input(trace, x), si = input(trace, start);
    const ParticleContact<Reverse> fixed = {
        constant(c.point), constant(c.normal), constant(c.travel), Reverse(c.radius),
        Reverse(c.ke),     Reverse(c.kd_by_h), Reverse(c.mu),      Reverse(c.slip)};
    const Reverse phi = moved.phi(where(touching, particle_contact_block(xi, si, fixed)));
    trace.run(phi.node);
    moved.own = moved.own + bar(xi);
    by_start = by_start + bar(si);
  });
  adjoint_slots<kSpring>(sweep, bars, group, x, trace, moved);
  adjoint_slots<kTriangle>(sweep, bars, group, x, trace, moved);
  adjoint_slots<kHingeOpposite>(sweep, bars, group, x, trace, moved);
  adjoint_slots<kHingeEnd>(sweep, bars, group, x, trace, moved);
  adjoint_slots<kTetrahedron>(sweep, bars, group, x, trace, moved);
  for (int32_t l = 0; l < filled; ++l) {
    add_row(bars.own, particle[l], moved.own, l);
    add_row(bars.target, particle[l], inertia, l);
    add_row(bars.start, particle[l], by_start, l);
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
