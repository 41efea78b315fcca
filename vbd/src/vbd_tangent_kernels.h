// The forces of VBD and their derivative along a direction on devices, a thread for each particle;
// sweep_tangent.cpp is the same on the CPU, and explains it.
#pragma once

#include "novaphy/vbd/lane_slots_kernels.h"
#include "novaphy/vbd/slot_inputs_law.h"
#include "novaphy/vbd/tangent_law.h"

namespace novaphy {

// Derivatives along a direction; null: 0.
struct VbdTangentArguments {
  NOVAPHY_ARGUMENTS(Part<VbdSweepArguments> sweep; Optional<Reads<VbdRow>> x, start, target;
                    Optional<Reads<float>> mass;       // by mass/h^2, per particle
                    Optional<Reads<float>> contacts;   // kContactLawFloats for each contact
                    Optional<Updates<float>> numbers;  // of slots, of all their numbers
                    Each<Number<int64_t>, 5> begins;   // where those of a role begin
                    Optional<Reads<VbdRow>> load;      // added to the derivative of f
                    Number<int64_t> at_rest;           // at a solution, where f = 0
                    Number<int64_t> keeps_loads;       // see Tangents
                    // Written: f, its derivative, and that of the steps of the particles; null:
                    // not wanted.
                    Optional<Updates<VbdRow>> force, force_slope, step_slope;)
};
NOVAPHY_BLOCK_KERNEL(vbd_tangent, VbdTangentArguments);
// Of what slots have of the start: written to `numbers`.
NOVAPHY_BLOCK_KERNEL(vbd_tangent_start, VbdTangentArguments);

struct VbdTangentMoveArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> particle, filled; Number<int64_t> first_group, lanes;
                    Reads<VbdRow> step; Updates<VbdRow> x;)
};
// The particles of a colour take their steps. `row`: over the lanes of its groups.
NOVAPHY_ROW_KERNEL(vbd_tangent_move, VbdTangentMoveArguments) {
  const int64_t of_color = row / a.lanes, group = a.first_group + of_color;
  if (row - of_color * a.lanes >= a.filled[group]) return;
  const int32_t p = a.particle[a.first_group * a.lanes + row];
  a.x[p] = to_row(to_vec3(a.x[p]) + to_vec3(a.step[p]));
}

#ifdef NOVAPHY_KERNEL
namespace vbd {

// A lane of a group, with the derivatives of what it reads.
struct TangentLane {
  using Tangent = TangentOf<float>;
  const VbdTangentArguments& a;
  int64_t group;
  int32_t lane, particle;
  Vec3<Tangent> x;

  TangentLane(const VbdTangentArguments& arguments, int64_t g, int32_t l, bool at_start = false)
      : a(arguments), group(g), lane(l), particle(a.sweep.particle[g * kVbdLanes + l]) {
    x = at_start ? start(particle) : place(particle);
  }
  static Vec3<Tangent> row(const VbdRow* values, const VbdRow* slopes, int32_t p) {
    return with_slope(at(values, p), slopes != nullptr ? at(slopes, p) : Vec3f{});
  }
  Vec3<Tangent> place(int32_t p) const { return row(a.sweep.x, a.x, p); }
  Vec3<Tangent> start(int32_t p) const { return row(a.sweep.start, a.start, p); }
  static Vec3<Tangent> still(const Vec3f& v) { return with_slope(v, Vec3f{}); }

  // Calls body(what a slot reads, the rows of the derivatives of its numbers or null).
  template <Role role, class Body>
  void for_inputs(bool at_start, const Body& body) const {
    for_lane_slots<role>(a.sweep, group, lane, [&](const LaneSlot<role>& slot) {
      const int64_t from = slot.floats - a.sweep.floats[role];
      float* const slopes = a.numbers != nullptr ? a.numbers + a.begins[role] + from : nullptr;
      SlotInputs<role, Tangent> in;
      in.own = x;
      for (int k = 0; k < kOthers[role]; ++k) {
        const int32_t p = slot.index(other_place<role>(k));
        in.others[k] = at_start ? start(p) : place(p);
      }
      for (int k = 0; k < kFloats[role]; ++k)
        in.numbers[k] = Tangent(slot.number(k), slopes != nullptr ? slopes[k * kVbdLanes] : 0.0f);
      body(in, slopes);
    });
  }
  template <Role role>
  void add_slots(Block<Tangent>& block) const {
    for_inputs<role>(false, [&](const SlotInputs<role, Tangent>& in, float*) {
      block = block + block_of(in, ((a.sweep.damped >> role) & 1) != 0);
    });
  }
  template <Role role>
  void put_starts() const {
    for_inputs<role>(true, [&](const SlotInputs<role, Tangent>& in, float* slopes) {
      start_of_slot(in, [&](int k, const Tangent& value) {
        slopes[(kFloats[role] - kStartFloats[role] + k) * kVbdLanes] = value.d;
      });
    });
  }
  Block<Tangent> contacts() const {
    const VbdSweepArguments& s = a.sweep;
    Block<Tangent> outer;
    if (s.contact_begin == nullptr) return outer;
    const Vec3<Tangent> begin = start(particle);
    for (int32_t k = s.contact_begin[particle]; k < s.contact_begin[particle + 1]; ++k) {
      const ParticleContact<float> c = contact_of(s, k);
      const float* const slopes = a.contacts != nullptr
                                      ? a.contacts + static_cast<int64_t>(k) * kContactLawFloats
                                      : nullptr;
      const auto slope = [slopes](int n) { return slopes != nullptr ? slopes[n] : 0.0f; };
      const float by_mu =
          a.keeps_loads != 0 ? slope_that_keeps_load(value_of(x), slope_of(x), c) : slope(3);
      const ParticleContact<Tangent> contact = {
          still(c.point),          still(c.normal),
          still(c.travel),         Tangent(c.radius, slope(0)),
          Tangent(c.ke, slope(1)), Tangent(c.kd_by_h, slope(2)),
          Tangent(c.mu, by_mu),    Tangent(c.slip)};
      outer = outer + particle_contact_block(x, begin, contact);
    }
    return outer;
  }
  // In the order of block_at.
  Block<Tangent> block() const {
    const VbdSweepArguments& s = a.sweep;
    Block<Tangent> outer = contacts();
    add_slots<kSpring>(outer);
    Block<Tangent> sum = inertia_block(x, row(s.target, a.target, particle),
                                       Tangent(s.mass_by_h2[group * kVbdLanes + lane],
                                               a.mass != nullptr ? a.mass[particle] : 0.0f));
    add_slots<kTriangle>(sum);
    add_slots<kHingeOpposite>(sum);
    add_slots<kHingeEnd>(sum);
    add_slots<kTetrahedron>(sum);
    return sum + outer;
  }
};

// Calls body(group, lane) where the row of a launch is a particle.
template <class Body>
inline void for_particle(const VbdSweepArguments& s, int64_t block, const Body& body) {
  const int64_t row = block * 128 + static_cast<int64_t>(threadIdx.x), of_launch = row / kVbdLanes,
                group = s.first_group + of_launch;
  const auto lane = static_cast<int32_t>(row - of_launch * kVbdLanes);
  if (group < s.end_group && lane < s.filled[group]) body(group, lane);
}

}  // namespace vbd

NOVAPHY_BLOCK_BODY(vbd_tangent, VbdTangentArguments) {
  using namespace vbd;
  for_particle(a.sweep, block, [&](int64_t group, int32_t lane) {
    const TangentLane of(a, group, lane);
    const Block<TangentOf<float>> b = of.block();
    const Vec3f f = value_of(b.f), slope = slope_of(b.f);
    const int32_t p = of.particle;
    if (a.force != nullptr) a.force[p] = to_row(f);
    if (a.force_slope != nullptr) a.force_slope[p] = to_row(slope);
    if (a.step_slope == nullptr) return;
    const Block<float> values = {f, b.h00.v, b.h11.v, b.h22.v, b.h01.v, b.h02.v, b.h12.v};
    const auto factors = factorize(values, a.sweep.regularization.value);
    Vec3f load = slope + (a.load != nullptr ? at(a.load, p) : Vec3f{});
    if (a.at_rest == 0) {
      const Block<float> turned = {slope, b.h00.d, b.h11.d, b.h22.d, b.h01.d, b.h02.d, b.h12.d};
      load = load - multiply_stiffness(turned, solve_block(factors, f));
    }
    a.step_slope[p] = to_row(solve_block(factors, load));
  });
}
NOVAPHY_BLOCK_BODY(vbd_tangent_start, VbdTangentArguments) {
  using namespace vbd;
  for_particle(a.sweep, block, [&](int64_t group, int32_t lane) {
    const TangentLane of(a, group, lane, true);
    of.put_starts<kSpring>();
    of.put_starts<kTriangle>();
    of.put_starts<kHingeOpposite>();
    of.put_starts<kHingeEnd>();
    of.put_starts<kTetrahedron>();
  });
}
#endif

}  // namespace novaphy
