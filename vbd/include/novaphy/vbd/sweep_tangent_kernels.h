// The tangent of a sweep (sweep_kernels.h) along a direction. A particle moves by d = H^-1 f, so
// the tangent of d is d' = H^-1 (f' - H' d). At a solution f = 0, and d' = H^-1 f'.
#pragma once

#include "novaphy/math/dual.h"
#include "novaphy/vbd/sweep_kernels.h"

namespace novaphy {

// The tangents that a sweep reads and writes. A null input means 0.
struct VbdTangentArguments {
  NOVAPHY_ARGUMENTS(Part<VbdSweepArguments> sweep; Optional<Reads<VbdRow>> x, start, target;
                    Optional<Reads<float>> mass;      // tangent of mass/h^2, per particle
                    Optional<Reads<float>> contacts;  // kContactLawFloats for each contact
                    // for each contact, 1: its force and stiffness have the tangent 0
                    Optional<Reads<int32_t>> held;
                    // the tangents of all numbers of the slots
                    Optional<Updates<float>> numbers;
                    Each<Number<int64_t>, vbd::kRoles> begins;  // where the numbers of a role begin
                    Optional<Reads<VbdRow>> load;               // added to f'
                    Number<int64_t> at_solution;                // 1: at a solution, where f = 0
                    // The friction loads are those at these positions, as in the energy of the
                    // safeguard. f then has a potential. Null: the loads at x.
                    Optional<Reads<VbdRow>> loads_at;
                    // Outputs: f, f', and the tangent of the particles' steps. Null: not computed.
                    Optional<Updates<VbdRow>> force, force_tangent, step_tangent;
                    // The ends of a given step d = after - before of all particles. If not null,
                    // the sum leaves out elements, and force_tangent is f' - H' d.
                    Optional<Reads<VbdRow>> before, after;)
};

namespace vbd {

// Returns the vectors of some particles as dual numbers. Without `tangents` the tangents are 0.
template <class S>
Vec3<math::Dual<S>> gather_tangents(const VbdRow* values, const VbdRow* tangents,
                                    const int32_t* index) {
  return math::with_tangent(
      LaneAccess<S>::gather(values, index),
      tangents != nullptr ? LaneAccess<S>::gather(tangents, index) : Vec3<S>{});
}

// The lanes of a group, with the values and tangents of their inputs as dual numbers.
template <class S>
struct TangentGroup {
  using Access = LaneAccess<S>;
  using Tangent = math::Dual<S>;
  using Point = Vec3<Tangent>;
  const VbdTangentArguments& a;
  const LaneGroup<S>& g;

  Point place(const int32_t* p) const { return gather_tangents<S>(a.sweep.x, a.x, p); }
  Point start(const int32_t* p) const { return gather_tangents<S>(a.sweep.start, a.start, p); }
  static Point still(const Vec3<S>& v) { return math::with_tangent(v, Vec3<S>{}); }

  // The numbers of a slot as dual numbers. Without `tangents` the tangents are 0.
  template <Role role>
  struct Numbers {
    Slot<role, S> slot;
    float* tangents;
    Tangent operator[](int k) const {
      return {slot[k], tangents != nullptr ? Access::load(tangents + k * Access::kStride) : S{}};
    }
  };
  template <Role role>
  Numbers<role> numbers(const Slot<role, S>& slot) const {
    float* const tangents = a.numbers;
    return {slot, tangents == nullptr
                      ? nullptr
                      : tangents + (a.begins[role].value + (slot.floats - a.sweep.floats[role]))};
  }
  template <Role role>
  void add_slots(const Point& x, Block<Tangent>& block) const {
    for_slots<role>(g, [&](const Slot<role, S>& slot) {
      const auto in = inputs_of(slot, x, numbers(slot), [&](const int32_t* p) { return place(p); });
      block = block + block_of(in, g.is_damped(role), a.sweep.turns != 0);
    });
  }
  Block<Tangent> contacts(const Point& x) const {
    Block<Tangent> outer;
    if (a.sweep.contact_begin == nullptr) return outer;
    const Point begin = start(g.particle);
    for_contacts(g, [&](const LaneContacts<S>& all) {
      const ParticleContact<S>& c = all.contact;
      S tangents[kContactLawFloats] = {};
      for (int l = 0; a.contacts != nullptr && l < g.filled; ++l)
        for (int n = 0; all.number[l] >= 0 && n < kContactLawFloats; ++n)
          Access::set(tangents[n], l,
                      a.contacts[static_cast<int64_t>(all.number[l]) * kContactLawFloats + n]);
      ParticleContact<Tangent> contact = {still(c.point),      still(c.normal),
                                          still(c.travel),     {c.radius, tangents[0]},
                                          {c.ke, tangents[1]}, {c.kd_by_h, tangents[2]},
                                          {c.mu, tangents[3]}, Tangent(c.slip),
                                          Tangent(c.inside),   Tangent(c.reach)};
      if (a.loads_at != nullptr) contact.mu = friction_of_load(x, still(g.at(a.loads_at)), contact);
      outer =
          outer + where(all.touching, without_held(all, particle_contact_block(x, begin, contact)));
    });
    return outer;
  }
  Block<Tangent> without_held(const LaneContacts<S>& all, Block<Tangent> block) const {
    if (a.held == nullptr) return block;
    S part{};
    for (int l = 0; l < g.filled; ++l)
      Access::set(part, l, all.number[l] >= 0 && a.held[all.number[l]] == 0 ? 1.0f : 0.0f);
    const auto times_part = [&part](Tangent& number) { number.d = number.d * part; };
    times_part(block.f.x), times_part(block.f.y), times_part(block.f.z);
    times_part(block.h00), times_part(block.h11), times_part(block.h22);
    times_part(block.h01), times_part(block.h02), times_part(block.h12);
    return block;
  }
  Tangent mass() const {
    S mass{};
    for (int l = 0; a.mass != nullptr && l < g.filled; ++l)
      Access::set(mass, l, a.mass[g.particle[l]]);
    return {g.mass_by_h2(), mass};
  }
  // Returns the block as dual numbers. The sum has the order of block_at.
  Block<Tangent> block(const Point& x) const {
    Block<Tangent> outer = contacts(x);
    const bool all = a.after == nullptr;
    if (all) for_roles_that_are<true>([&](auto is) { add_slots<decltype(is)::role>(x, outer); });
    const Point target = gather_tangents<S>(a.sweep.target, a.target, g.particle);
    Block<Tangent> sum = inertia_block(x, target, mass());
    if (all) for_roles_that_are<false>([&](auto is) { add_slots<decltype(is)::role>(x, sum); });
    return sum + outer;
  }
};

template <class S>
void tangent(const VbdTangentArguments& a, const LaneGroup<S>& g) {
  if (g.filled == 0) return;
  const TangentGroup<S> of = {a, g};
  const Block<math::Dual<S>> b = of.block(of.place(g.particle));
  const Vec3<S> f = math::value_of(b.f);
  Vec3<S> tangent = math::tangent_of(b.f);
  if (a.force != nullptr) g.put(a.force, f);
  const Block<S> turned = {tangent, b.h00.d, b.h11.d, b.h22.d, b.h01.d, b.h02.d, b.h12.d};
  if (a.after != nullptr) tangent = tangent - multiply_stiffness(turned, step_of<S>(a, g.particle));
  if (a.force_tangent != nullptr) g.put(a.force_tangent, tangent);
  if (a.step_tangent == nullptr) return;
  const Block<S> values = {f, b.h00.v, b.h11.v, b.h22.v, b.h01.v, b.h02.v, b.h12.v};
  const auto factors = factorize(values, S(a.sweep.regularization.value));
  Vec3<S> load = tangent + (a.load != nullptr ? g.at(a.load) : Vec3<S>{});
  if (a.at_solution == 0) load = load - multiply_stiffness(turned, solve_block(factors, f));
  g.put(a.step_tangent, solve_block(factors, load));
}

// Writes the tangents of the slots' values at the start of the step to `numbers`.
template <class S>
void tangent_start(const VbdTangentArguments& a, const LaneGroup<S>& g) {
  if (g.filled == 0) return;
  const TangentGroup<S> of = {a, g};
  const Vec3<math::Dual<S>> x = of.start(g.particle);
  for_roles([&](auto is) {
    constexpr Role role = decltype(is)::role;
    for_slots<role>(g, [&](const Slot<role, S>& slot) {
      const auto numbers = of.numbers(slot);
      const auto in = inputs_of(slot, x, numbers, [&](const int32_t* p) { return of.start(p); });
      decltype(is)::Slot::put_start(in, [&](int k, const math::Dual<S>& value) {
        LaneAccess<S>::store(numbers.tangents + (start_begin(role) + k) * LaneAccess<S>::kStride,
                             value.d);
      });
    });
  });
}

}  // namespace vbd
}  // namespace novaphy
