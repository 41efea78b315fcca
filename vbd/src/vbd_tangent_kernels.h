// The forces of VBD and their derivative along a direction of the positions on devices, a thread
// for each particle; sweep_tangent.cpp is the same on the CPU, and explains it. At a solution,
// where f = 0, and of positions alone.
#pragma once

#include "novaphy/vbd/lane_slots_kernels.h"
#include "novaphy/vbd/slot_inputs_trace.h"
#include "novaphy/vbd/tangent_trace.h"

namespace novaphy {

struct VbdTangentArguments {
  NOVAPHY_ARGUMENTS(Part<VbdSweepArguments> sweep;
                    Optional<Reads<VbdRow>> x;  // the direction; null: 0
                    Optional<Reads<VbdRow>>
                        load;  // added to the derivative of f before it is solved with; null: 0
                    Number<int64_t> keeps_loads;      // see Tangents
                    Optional<Updates<VbdRow>> force;  // f, its derivative, and that of the steps of
                                                      // the particles; null: not wanted
                    Optional<Updates<VbdRow>> force_slope, step_slope;)
};
NOVAPHY_BLOCK_KERNEL(vbd_tangent, VbdTangentArguments);

struct VbdTangentMoveArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> particle, filled; Number<int64_t> first_group;
                    Reads<VbdRow> step; Updates<VbdRow> x;)
};
// The particles of a colour take their steps. `row`: over the lanes of its groups.
NOVAPHY_ROW_KERNEL(vbd_tangent_move, VbdTangentMoveArguments) {
  const int64_t of_color = row / kVbdLanes, group = a.first_group + of_color;
  if (row - of_color * kVbdLanes >= a.filled[group]) return;
  const int32_t p = a.particle[a.first_group * kVbdLanes + row];
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

  TangentLane(const VbdTangentArguments& arguments, int64_t g, int32_t l)
      : a(arguments), group(g), lane(l), particle(a.sweep.particle[g * kVbdLanes + l]) {
    x = place(particle);
  }
  Vec3<Tangent> place(int32_t p) const {
    return with_slope(at(a.sweep.x, p), a.x != nullptr ? at(a.x, p) : Vec3f{});
  }
  static Vec3<Tangent> still(const Vec3f& v) { return with_slope(v, Vec3f{}); }

  template <Role role>
  void add_slots(Block<Tangent>& block) const {
    for_lane_slots<role>(a.sweep, group, lane, [&](const LaneSlot<role>& slot) {
      SlotInputs<role, Tangent> in;
      in.own = x;
      for (int k = 0; k < kOthers[role]; ++k)
        in.others[k] = place(slot.index(other_place<role>(k)));
      for (int k = 0; k < kFloats[role]; ++k) in.numbers[k] = Tangent(slot.number(k));
      block = block + block_of(in, ((a.sweep.damped >> role) & 1) != 0);
    });
  }
  Block<Tangent> contacts() const {
    const VbdSweepArguments& s = a.sweep;
    Block<Tangent> outer;
    if (s.contact_begin == nullptr) return outer;
    const Vec3<Tangent> start = still(at(s.start, particle));
    for (int32_t k = s.contact_begin[particle]; k < s.contact_begin[particle + 1]; ++k) {
      const ParticleContact<float> c = contact_of(s, k);
      const float by_mu =
          a.keeps_loads != 0 ? slope_that_keeps_load(value_of(x), slope_of(x), c) : 0.0f;
      const ParticleContact<Tangent> contact = {
          still(c.point), still(c.normal),    still(c.travel),      Tangent(c.radius),
          Tangent(c.ke),  Tangent(c.kd_by_h), Tangent(c.mu, by_mu), Tangent(c.slip)};
      outer = outer + particle_contact_block(x, start, contact);
    }
    return outer;
  }
  // In the order of block_at.
  Block<Tangent> block() const {
    const VbdSweepArguments& s = a.sweep;
    Block<Tangent> outer = contacts();
    add_slots<kSpring>(outer);
    Block<Tangent> sum = inertia_block(x, still(at(s.target, particle)),
                                       Tangent(s.mass_by_h2[group * kVbdLanes + lane]));
    add_slots<kTriangle>(sum);
    add_slots<kHingeOpposite>(sum);
    add_slots<kHingeEnd>(sum);
    add_slots<kTetrahedron>(sum);
    return sum + outer;
  }
};

}  // namespace vbd

NOVAPHY_BLOCK_BODY(vbd_tangent, VbdTangentArguments) {
  using namespace vbd;
  const VbdSweepArguments& s = a.sweep;
  const int64_t row = block * 128 + static_cast<int64_t>(threadIdx.x), of_launch = row / kVbdLanes,
                group = s.first_group + of_launch;
  const auto lane = static_cast<int32_t>(row - of_launch * kVbdLanes);
  if (group >= s.end_group || lane >= s.filled[group]) return;
  const TangentLane of(a, group, lane);
  const Block<TangentOf<float>> b = of.block();
  const Vec3f f = value_of(b.f), slope = slope_of(b.f);
  const int32_t p = of.particle;
  if (a.force != nullptr) a.force[p] = to_row(f);
  if (a.force_slope != nullptr) a.force_slope[p] = to_row(slope);
  if (a.step_slope == nullptr) return;
  const Block<float> values = {f, b.h00.v, b.h11.v, b.h22.v, b.h01.v, b.h02.v, b.h12.v};
  const Vec3f load = slope + (a.load != nullptr ? at(a.load, p) : Vec3f{});
  a.step_slope[p] = to_row(solve_block(factorize(values, s.regularization.value), load));
}
#endif

}  // namespace novaphy
