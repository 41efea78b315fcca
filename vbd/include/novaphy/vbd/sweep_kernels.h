// A sweep of VBD over the particles of groups, as templates over the scalar. A group is a set of
// particles of one color, one in each lane. On devices the scalar is a float, and a thread handles
// one lane. On the CPU the scalar holds all lanes of a group in a SIMD register (src/lanes.h),
// compiled once for each instruction set. Both scalars give the same bits.
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/vbd/elements/list.h"
#include "novaphy/vbd/particle_contact_law.h"
#include "novaphy/vbd/rows_kernels.h"

#ifndef NOVAPHY_LANE_FN  // for float; src/lanes.h defines other values
#define NOVAPHY_LANE_FN inline
#endif
#ifndef NOVAPHY_LANE_FN_APART  // for large functions with many callers
#define NOVAPHY_LANE_FN_APART inline
#endif

namespace novaphy {

// On devices: the lanes of a group, the groups of a large thread block, and the terms that fit into
// the memory of a thread block (see vbd_move_by_blocks).
constexpr int kVbdLanes = 4, kVbdLargeBlock = 8, kVbdBlockTerms = 832;

// ParticleContact::reach of the sweeps beside a coarse correction.
constexpr float kVbdContactReach = 0.1f;

struct VbdSweepArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> particle;  // of each lane of each group
                    Reads<int32_t> filled;    // count of lanes of a group with a particle
                    Reads<float> mass_by_h2;  // of each lane (kg/s^2); 1 if it has no particle
                    // for each role: the first slot of each group
                    Each<Reads<int64_t>, vbd::kRoles> begin; Each<Reads<int32_t>, vbd::kRoles> ints;
                    Each<Updates<float>, vbd::kRoles> floats;
                    Optional<Reads<int32_t>> contact_begin;  // null: no contacts
                    Optional<Reads<float>> contacts; Reads<VbdRow> start, target;
                    Updates<VbdRow> moved, x,
                    to;  // new positions of a color: x, or separate memory
                    Number<float> regularization, slip, inside;  // see ParticleContact
                    Number<int64_t> lanes;                       // count of lanes of a group
                    Number<int64_t> damped;                      // bit r: role r has damping
                    // 1: blocks for a coarse correction (argument `turns` of block_of, and
                    // ParticleContact::reach)
                    Number<int64_t> turns;
                    Number<int64_t> first_group, end_group,
                    block_groups;            // groups of a thread block: 1 or kVbdLargeBlock
                    Writes<float> residual;  // output of vbd_residual and of write_block
  )
};

namespace vbd {

// How a sweep reads and writes its scalar S, which holds kLanes lanes of a group of kStride lanes.
template <class S>
struct LaneAccess;
template <>
struct LaneAccess<float> {
  static constexpr int kLanes = 1, kStride = kVbdLanes;
  // Keeps the index in a register. Otherwise a device thread would load the index again after each
  // store.
  struct Particles {
    int32_t index;
    Particles(const int32_t* from) : index(*from) {}
    operator const int32_t*() const { return &index; }
  };
  static Vec3f gather(const VbdRow* rows, const int32_t* index) { return to_vec3(rows[*index]); }
  static float load(const float* from) { return *from; }
  static void store(float* to, float value) { *to = value; }
  // Reads or writes one lane of a value.
  static float get(float values, int) { return values; }
  static void set(float& values, int, float value) { values = value; }
  static bool get(bool mask, int) { return mask; }
  static void set(bool& mask, int, bool value) { mask = value; }
  static void put(VbdRow* rows, int32_t p, const Vec3f& v, int) { rows[p] = to_row(v); }
  static void add(VbdRow* rows, int32_t p, const Vec3f& v, int) {
    rows[p] = to_row(to_vec3(rows[p]) + v);
  }
};
template <class S>
using MaskOf = decltype(S() < S());

// The lanes of a group that one scalar holds. `row` is the row of a launch over lanes.
template <class S>
struct LaneGroup : LaneAccess<S> {
  using Access = LaneAccess<S>;
  const VbdSweepArguments& a;
  int64_t group;
  int32_t lane, filled;                 // the first lane; the number of lanes with a particle
  typename Access::Particles particle;  // of each lane
  LaneGroup(const VbdSweepArguments& arguments, int64_t row)
      : a(arguments),
        group(a.first_group + row / Access::kStride),
        lane(static_cast<int32_t>(row % Access::kStride)),
        filled(a.filled[group]),
        particle(a.particle + (group * Access::kStride + lane)) {
    if (Access::kLanes == 1) filled = lane < filled ? 1 : 0;
  }
  Vec3<S> at(const VbdRow* rows) const { return Access::gather(rows, particle); }
  S mass_by_h2() const { return Access::load(a.mass_by_h2 + (group * Access::kStride + lane)); }
  bool is_damped(Role role) const { return ((a.damped >> role) & 1) != 0; }
  // Writes only the lanes with a particle.
  void put(VbdRow* rows, const Vec3<S>& values) const {
    for (int l = 0; l < filled; ++l) Access::put(rows, particle[l], values, l);
  }
  void add(VbdRow* rows, const Vec3<S>& values) const {
    for (int l = 0; l < filled; ++l) Access::add(rows, particle[l], values, l);
  }
};

template <class S>
NOVAPHY_LANE_FN_APART Vec3<S> gather_apart(const VbdRow* rows, const int32_t* particles) {
  return LaneAccess<S>::gather(rows, particles);
}
// Returns the given step of particles: after - before (m).
template <class S, class Arguments>
Vec3<S> step_of(const Arguments& a, const int32_t* particles) {
  return gather_apart<S>(a.after, particles) - gather_apart<S>(a.before, particles);
}

// A slot, for the lanes of one scalar. Its numbers have the order of SlotInputs::numbers.
template <Role role, class S>
struct Slot {
  using Access = LaneAccess<S>;
  const int32_t* ints;
  float* floats;
  int64_t number;
  int32_t lane;
  Slot(const VbdSweepArguments& a, int64_t s, int32_t first_lane)
      : ints(a.ints[role] + (s * (kOthers[role] * Access::kStride) + first_lane)),
        floats(a.floats[role] + (s * (kFloats[role] * Access::kStride) + first_lane)),
        number(s),
        lane(first_lane) {}
  S operator[](int k) const { return Access::load(floats + k * Access::kStride); }
  void set(int k, S value) const { Access::store(floats + k * Access::kStride, value); }
};

// Returns the inputs of a slot for a particle at `own`. gather(indices) returns the positions of
// another corner.
template <Role role, class S, class V, class Numbers, class Gather>
SlotInputs<role, V, Numbers> inputs_of(const Slot<role, S>& slot, const Vec3<V>& own,
                                       const Numbers& numbers, const Gather& gather) {
  const auto point = [&](int k) { return gather(slot.ints + k * LaneAccess<S>::kStride); };
  if constexpr (kOthers[role] == 1) {
    return {own, {point(0)}, numbers};
  } else if constexpr (kOthers[role] == 2) {
    return {own, {point(0), point(1)}, numbers};
  } else {
    return {own, {point(0), point(1), point(2)}, numbers};
  }
}
template <Role role, class S>
NOVAPHY_LANE_FN SlotInputs<role, S, Slot<role, S>> inputs_of(const Slot<role, S>& slot,
                                                             const Vec3<S>& own,
                                                             const VbdRow* rows) {
  return inputs_of(slot, own, slot,
                   [rows](const int32_t* index) { return LaneAccess<S>::gather(rows, index); });
}

template <Role role, class S>
NOVAPHY_LANE_FN_APART SlotInputs<role, S, Slot<role, S>> inputs_apart(const Slot<role, S>& slot,
                                                                      const Vec3<S>& own,
                                                                      const VbdRow* rows) {
  return inputs_of(slot, own, rows);
}

template <Role role, class S, class Body>
void for_slots(const LaneGroup<S>& g, const Body& body) {
  const int64_t* const begin = g.a.begin[role];
  if (begin == nullptr) return;
  for (int64_t s = begin[g.group]; s < begin[g.group + 1]; ++s) body(Slot<role, S>(g.a, s, g.lane));
}

// The k-th contact of each lane's particle, for one k. `number` is its row in the array of
// contacts, or -1 if the particle has no k-th contact. `touching` marks the lanes with a contact.
template <class S>
struct LaneContacts {
  MaskOf<S> touching{};
  int32_t number[LaneAccess<S>::kLanes];
  ParticleContact<S> contact;
};
template <class S, class Body>
void for_contacts(const LaneGroup<S>& g, const Body& body) {
  using Access = LaneAccess<S>;
  const VbdSweepArguments& a = g.a;
  if (a.contact_begin == nullptr) return;
  for (int32_t round = 0;; ++round) {
    float rows[kContactFloats][Access::kLanes] = {};
    LaneContacts<S> all;
    bool any = false;
    for (int l = 0; l < g.filled; ++l) {
      all.number[l] = -1;
      const int32_t k = a.contact_begin[g.particle[l]] + round;
      if (k >= a.contact_begin[g.particle[l] + 1]) continue;
      for (int c = 0; c < kContactFloats; ++c)
        rows[c][l] = a.contacts[static_cast<int64_t>(k) * kContactFloats + c];
      all.number[l] = k;
      Access::set(all.touching, l, true);
      any = true;
    }
    if (!any) return;
    const S reach = S(a.turns != 0 ? kVbdContactReach : 0.0f);
    const auto number = [&rows](int c) { return Access::load(rows[c]); };
    const auto point = [&](int c) { return Vec3<S>{number(c), number(c + 1), number(c + 2)}; };
    all.contact = {point(0),   point(3),   point(6),        number(9),         number(10),
                   number(11), number(12), S(a.slip.value), S(a.inside.value), reach};
    body(all);
  }
}
// Returns the sum of the blocks of all contacts of each particle.
template <template <class> class B = Block, class S>
B<S> contact_blocks(const LaneGroup<S>& g, const Vec3<S>& x) {
  B<S> outer;
  if (g.a.contact_begin == nullptr) return outer;
  const Vec3<S> start = g.at(g.a.start);
  for_contacts(g, [&](const LaneContacts<S>& c) {
    outer = outer + where(c.touching, particle_contact_block<B>(x, start, c.contact));
  });
  return outer;
}

// Returns the block of the particles of a group at x. The order of the sum is fixed: first contacts
// and outer elements, separately inertia and the other elements, then both sums. see(block)
// receives the sum over the contacts, and then the block of each element. B is Block or Force.
template <template <class> class B = Block, class S, class See>
B<S> block_at(const LaneGroup<S>& g, const Vec3<S>& x, const See& see) {
  const bool turns = g.a.turns != 0;
  const VbdRow* const q = g.a.x;
  B<S> outer = contact_blocks<B>(g, x);
  see(outer);
  const auto add = [&](auto is, B<S>& sum) {
    constexpr Role role = decltype(is)::role;
    const bool damped = g.is_damped(role);
    for_slots<role>(g, [&](const auto& s) {
      const B<S> block = block_of<B>(inputs_of(s, x, q), damped, turns);
      see(block);
      sum = sum + block;
    });
  };
  for_roles_that_are<true>([&](auto is) { add(is, outer); });
  B<S> block = inertia_block<B>(x, g.at(g.a.target), g.mass_by_h2());
  for_roles_that_are<false>([&](auto is) { add(is, block); });
  return block + outer;
}

template <template <class> class B = Block, class S>
B<S> block_at(const LaneGroup<S>& g, const Vec3<S>& x) {
  return block_at<B>(g, x, [](const B<S>&) {});
}

// Returns the energy of each particle at x (J): inertia, contacts and elements. The friction of
// contacts uses the loads at the position `from`.
template <class S>
S energy_at(const LaneGroup<S>& g, const Vec3<S>& x, const Vec3<S>& from) {
  using math::select;
  S energy = inertia_energy(x, g.at(g.a.target), g.mass_by_h2());
  for_contacts(g, [&](const LaneContacts<S>& c) {
    const S load = particle_contact_load(from, c.contact);
    const S of_contact = particle_contact_energy(x, g.at(g.a.start), c.contact, load);
    energy = energy + select(c.touching, of_contact, S(0.0f));
  });
  for_roles([&](auto is) {
    for_slots<decltype(is)::role>(g, [&](const auto& s) {
      energy = energy + decltype(is)::Slot::energy(inputs_apart(s, x, g.a.x));
    });
  });
  return energy;
}

// Computes the values of the slots at the start of the step, and stores them in the slots.
template <class S>
void prepare(const LaneGroup<S>& g) {
  const Vec3<S> x = g.at(g.a.start);
  for_roles([&](auto is) {
    constexpr Role role = decltype(is)::role;
    if (!g.is_damped(role)) return;
    for_slots<role>(g, [&](const auto& s) {
      decltype(is)::Slot::put_start(inputs_apart(s, x, g.a.start), [&](int k, const S& value) {
        s.set(start_begin(role) + k, value);
      });
    });
  });
}

// Returns the step d, halved up to four times while the energy would rise. Returns 0 if the energy
// would still rise.
template <class S>
Vec3<S> guarded_step(const LaneGroup<S>& g, const Vec3<S>& x, Vec3<S> d) {
  using math::select;
  const S before = energy_at(g, x, x), half(0.5f);
  for (int halvings = 0;; ++halvings) {
    const MaskOf<S> good = energy_at(g, x + d, x) <= before;
    bool all = true;
    for (int l = 0; l < g.filled; ++l) all = LaneAccess<S>::get(good, l) && all;
    if (all) return d;
    if (halvings == 4) return select(good, d, Vec3<S>{});
    d = select(good, d, d * half);
  }
}

// Moves each particle of a group by the step d that solves H d = f.
template <bool safeguard, class S>
void move(const LaneGroup<S>& g) {
  if (g.filled == 0) return;
  const Vec3<S> x = g.at(g.a.x);
  const Block<S> block = block_at(g, x);
  Vec3<S> d = solve_block(factorize(block, S(g.a.regularization.value)), block.f);
  if (safeguard) d = guarded_step(g, x, d);
  const Vec3<S> moved = g.at(g.a.moved) + d;
  g.put(g.a.moved, moved);
  g.put(g.a.to, g.at(g.a.start) + moved);
}

// Writes the block of each particle to `residual`, nine numbers for each particle: f, and then the
// entries of H in the order of Block.
template <class S>
void write_block(const LaneGroup<S>& g) {
  if (g.filled == 0) return;
  const Block<S> b = block_at(g, g.at(g.a.x));
  const S all[9] = {b.f.x, b.f.y, b.f.z, b.h00, b.h11, b.h22, b.h01, b.h02, b.h12};
  for (int l = 0; l < g.filled; ++l)
    for (int k = 0; k < 9; ++k)
      g.a.residual[9 * static_cast<int64_t>(g.particle[l]) + k] = LaneAccess<S>::get(all[k], l);
}

// The part of a particle in the sums of a residual. force: |f|^2. parts: the square of the sum of
// |f| over its contacts and elements. rounding: the square of the change of f by one rounding of
// the position.
struct ParticleResidual {
  float force = 0.0f, parts = 0.0f, rounding = 0.0f;
};
template <class S>
void residual(const LaneGroup<S>& g) {
  using namespace math;
  if (g.filled == 0) return;
  const Vec3<S> x = g.at(g.a.x);
  S parts{};
  const Block<S> b = block_at(g, x, [&](const Block<S>& part) { parts = parts + length(part.f); });
  const S size = max(abs(x.x), max(abs(x.y), abs(x.z)));
  const Vec3<S> rounded = multiply_stiffness(b, Vec3<S>{size, size, size} * S(0x1p-24f));
  const S all[3] = {dot(b.f, b.f), parts * parts, dot(rounded, rounded)};
  for (int l = 0; l < g.filled; ++l)
    for (int k = 0; k < 3; ++k)
      g.a.residual[3 * static_cast<int64_t>(g.particle[l]) + k] = LaneAccess<S>::get(all[k], l);
}

}  // namespace vbd
}  // namespace novaphy
